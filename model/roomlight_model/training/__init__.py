"""Training of the networks in stages (paper, "Training"). Needs PyTorch.

`examples` turns recordings into examples and augments them, `batches` into tensors; `stages` has the losses,
`gradients` their gradients, `trainer` the loop; `validation` scores held-out rooms and `subsets` selects them.
"""
