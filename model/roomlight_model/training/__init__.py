"""Training of the networks, stage by stage (paper, "Training"). Needs PyTorch."""
