"""Uploaded recordings: their files, the process that reads one, its replay into a session, and their store."""
