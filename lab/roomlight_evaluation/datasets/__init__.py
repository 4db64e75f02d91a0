"""Light scored on a dataset's rooms: single images, and walks."""
