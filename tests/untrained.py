"""Checkpoints of weights that were never trained."""

import torch

from roomlight_model.checkpoint import build_network, save_checkpoint


def save_untrained(path, form, config, *, seed=0):
    """Write freshly initialised weights (card: steps 0); the same seed gives the same weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = build_network(form, config)
    save_checkpoint(path, model, card={"steps": 0, "seed": seed})
