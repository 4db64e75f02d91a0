"""Generator of training data: furnished rooms, their light, and recordings of camera walks through them."""
