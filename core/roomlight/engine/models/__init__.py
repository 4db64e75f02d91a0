"""The lighting models: classical (no networks), and the paper's networks, single view or recurrent."""
