"""Camera walks through a lit room, rendered as a phone records them."""
