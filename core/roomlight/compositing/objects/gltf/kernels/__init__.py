"""Compiled loops of the glTF reader: `meshopt` decodes compressed buffer views."""
