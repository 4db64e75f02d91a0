"""Training of the networks in stages (paper, "Training"). Needs PyTorch.

`loop` runs any stage: batches, steps, averaged weights, validation, checkpoints, resuming; `run_folder` has its options
and files. A stage is its data, its forward pass and its loss, in one file each:

| file          | stages                                     | examples                                  |
|---------------|--------------------------------------------|-------------------------------------------|
| `single_view` | `single-sglv`, `single-blend`, `-joint`    | frames of recordings                      |
| `video`       | `video-sglv`, `video-blend`, `-joint`      | sequences of frames, with gradients through time |
| `clipping`    | `clipping`                                 | frames, exposed anew at every step        |
| `objects`     | `objects`                                  | what streams have shown a probe           |

A recording's way to a batch: `subsets` chooses sequences, `examples` draws and augments frames, `sequences` and
`light_changes` make sequences of them, `batches` makes tensors. `losses` has what single views and sequences share, and
distributes a batch over threads; `small_stage` is what the stages of small networks share, `validation` scores held-out
rooms. `recipe` reads a file of `recipes/`, which states the data and the stages of a shipped network.
"""
