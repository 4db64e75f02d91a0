"""RoomLight's networks in PyTorch, and their training.

The paper's parts and where they are:

| paper                                             | module                                                |
|---------------------------------------------------|-------------------------------------------------------|
| the whole model, single-view and video            | `networks`: `SingleModel`, `VideoModel`               |
| SGEncoder, SGDecoder, SGGRU: the lighting volume  | `volume_networks`                                     |
| BlendEncoder, BlendDecoder, BlendGRU: panoramas   | `panorama_networks`                                   |
| convolutions and GRUs that both use               | `layers`                                              |
| SGLV ray tracing, equations 1 and 2               | `ray_marching`; readable twin `ray_marching_reference`|
| blending and accumulation over frames             | `accumulate`                                          |
| rendering loss: a glossy sphere, equation R_p     | `sphere_rendering`                                    |
| losses and stages of training                     | `training.single_view`, `training.video`              |

Beside them, `clipping_network` estimates the radiance of clipped pixels, `object_light_network` the light of virtual
objects, `depth` the depth of pictures. `config` holds the widths, `checkpoint` reads and writes the weights of all,
`training` trains them. Each differentiable module is compared with the serving code in `roomlight.engine` by a test.
Importing this package and `config` needs no PyTorch; all else does.
"""
