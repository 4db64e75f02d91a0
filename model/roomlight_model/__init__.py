"""Networks and training data (the networks need PyTorch; the sample room does not)."""
