"""The small networks: ranges, the identity at the start, rotation."""

import torch

from roomlight.engine.lighting import LIGHTING_PANELS
from roomlight.engine.networks.clipping import CHANNELS, SIDE
from roomlight.engine.panorama.panels import HEIGHT
from roomlight_model.clipping_network import LOG_RANGE, ClippingNetwork
from roomlight_model.object_light_network import ObjectLightNetwork


def test_clipped_radiance_stays_in_its_range():
    torch.manual_seed(0)
    network = ClippingNetwork()
    planes = torch.rand(1, CHANNELS, SIDE, SIDE)
    assert network(planes).shape == (1, 3, SIDE // 2, SIDE // 2)
    network.head.weight.data *= 1e4
    radiance = network(planes)
    assert radiance.min() >= LOG_RANGE[0]
    assert radiance.max() <= LOG_RANGE[1]


def test_the_light_of_objects_begins_without_a_change():
    assert (ObjectLightNetwork()(torch.rand(2, LIGHTING_PANELS, HEIGHT, 2 * HEIGHT)) == 0).all()


def test_the_light_of_objects_rotates_with_the_panorama():
    """By eight columns, the coarsest layer's; further ones would interpolate."""
    torch.manual_seed(1)
    network = ObjectLightNetwork()
    torch.nn.init.normal_(network.head.conv.weight, std=0.1)
    panels = torch.rand(1, LIGHTING_PANELS, HEIGHT, 2 * HEIGHT)
    with torch.no_grad():
        rolled, expected = network(panels.roll(8, 3)), network(panels).roll(8, 3)
    inner = torch.ones(2 * HEIGHT, dtype=torch.bool)
    inner[6:10] = False  # the last interpolation does not wrap around at the seam
    inner[-2:] = inner[:2] = False
    assert torch.allclose(rolled[..., inner], expected[..., inner], atol=1e-5)
    assert expected.std() > 0.01
