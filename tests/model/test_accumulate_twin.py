"""The panorama recursion in PyTorch against the serving kernel, and the rule itself."""

import numpy as np
import torch

from recordings import BoxRecordings
from roomlight.engine.panorama import blend as serving
from roomlight.engine.session import Session, SessionOptions
from roomlight_model.accumulate import (
    Observation,
    Panorama,
    accepted,
    accumulate,
    conservative,
    fill_in,
    first_panorama,
)

HEIGHT = 12
DEPTH_MAX_M = 3.0
UNSEEN_M = serving.unseen_depth_m(DEPTH_MAX_M)


def frames(count, seed=0):
    random = np.random.default_rng(seed)
    shape = (HEIGHT, 2 * HEIGHT)
    for _ in range(count):
        mask = random.random(shape) < 0.6
        yield {
            "hdr": random.exponential(2.0, (*shape, 3)).astype(np.float32),
            "detail": random.random((*shape, 3), np.float32),
            "detail_depth_m": (0.5 + 2 * random.random(shape, np.float32)) * mask,
            "weight": random.random(shape, np.float32) * mask,
        }


def planes(array):
    """[h, w] or [h, w, c] to [1, c, h, w]."""
    return torch.from_numpy(np.atleast_3d(array).transpose(2, 0, 1)[None].copy())


def serve(state, frame, clipped=None, guessed=None):
    """Blend a frame's planes as the serving engine does."""
    seen = serving.PartialPanorama(frame["detail"], frame["weight"] > 0, frame["detail_depth_m"], clipped, guessed)
    serving.accumulate(state, seen, hdr=frame["hdr"], weight=frame["weight"], unseen_m=UNSEEN_M)


def observed(frame, **clipping):
    """A frame's planes as the networks' input, and its weight."""
    hdr, ldr, depth, weight = (planes(frame[name]) for name in ("hdr", "detail", "detail_depth_m", "weight"))
    return Observation(hdr, ldr, (weight > 0).float(), depth, **clipping), weight


def test_agrees_with_serving():
    """Six frames from nothing seen. Tolerance: both are float32, the kernel with fast-math reordering."""
    kept = serving.PanoramaState.fresh(HEIGHT, DEPTH_MAX_M)
    state = Panorama(planes(kept.radiance), planes(kept.depth_m), planes(kept.observed))
    for frame in frames(6):
        serve(kept, frame)
        seen, weight = observed(frame)
        state = accumulate(state, seen, accepted(weight, seen, state, margin=serving.CLOSER_M))
    for ours, theirs in zip(state[:3], (kept.radiance, kept.depth_m, kept.observed), strict=True):
        torch.testing.assert_close(ours, planes(theirs), atol=2e-5, rtol=1e-5)


def test_a_sequence_of_exposures_agrees_with_serving():
    """Eight frames of one surface, clipped in part, of estimated radiance; the networks' weight is given.

    The engine's rule for changed light takes nothing here: the light of the surface is constant.
    """
    random, shape = np.random.default_rng(8), (HEIGHT, 2 * HEIGHT)
    light = random.uniform(0.2, 9, (*shape, 1)) * np.ones(3)
    kept = serving.PanoramaState.fresh(HEIGHT, DEPTH_MAX_M)
    nothing = planes(np.zeros(shape, np.float32))
    state = Panorama(planes(kept.radiance), planes(kept.depth_m), planes(kept.observed), nothing, nothing)
    replaced = 0
    for white in (1, 4, 2, 8, 1, 8, 16, 4):
        clipped = (light[..., 0] >= white).astype(np.float32)
        guessed = clipped * random.uniform(0, white, shape).astype(np.float32)
        view = {
            "hdr": random.exponential(2.0, (*shape, 3)).astype(np.float32),
            "detail": (np.minimum(light, white) + guessed[..., None]).astype(np.float32),
            "detail_depth_m": (2 + random.uniform(-0.05, 0.05, shape)).astype(np.float32),
            "weight": random.random(shape).astype(np.float32),
        }
        serve(kept, view, clipped, guessed)
        seen, raw = observed(view, clipped=planes(clipped), guessed=planes(guessed))
        with torch.autocast("cpu", dtype=torch.bfloat16):  # as in training
            weight = accepted(raw, seen, state, margin=serving.CLOSER_M)
        ruled = conservative(raw, seen.depth, state.depth, margin=serving.CLOSER_M)
        replaced += int((weight > ruled).sum())
        state = accumulate(state, seen, weight)
    assert replaced > 100
    wanted = (kept.radiance, kept.depth_m, kept.observed, kept.clipped, kept.guessed)
    for ours, theirs in zip(state, wanted, strict=True):
        torch.testing.assert_close(ours, planes(theirs), atol=2e-5, rtol=1e-4)


def test_constant_light_changes_nothing_in_serving(monkeypatch):
    """Hence training needs no twin of the rule for changed light: a walk in a box room, at changing exposure."""
    taken = []

    def counted(state, found, rule=serving.replaced_by_change):
        taken.append(rule(state, found))
        return taken[-1]

    monkeypatch.setattr(serving, "replaced_by_change", counted)
    session = Session(SessionOptions(model="classical", height=60))
    recording = BoxRecordings(1).read(0, frames=range(0, 31, 4))
    for position in recording.probe_positions:
        session.track(tuple(position.tolist()))
    for number, depth_mm in enumerate(recording.depth_mm):
        session.push(recording.frame(number, depth_mm))
    assert len(taken) == 3 * 8
    assert sum(int(one.sum()) for one in taken) == 0


def test_what_is_filled_in_agrees_with_serving():
    for frame in frames(3, seed=5):
        mask = frame["detail_depth_m"] > 0
        weight = np.random.default_rng(1).random(mask.shape, np.float32)
        wanted = serving.fill_in(frame["hdr"], frame["detail"], mask, weight=weight)
        found = fill_in(
            planes(frame["hdr"]), planes(frame["detail"]), planes(mask.astype(np.float32)), weight=planes(weight)
        )
        torch.testing.assert_close(found, planes(wanted), atol=1e-5, rtol=1e-5)


def test_first_frame_is_the_recursion_from_nothing_seen():
    seen, weight = observed(next(frames(1)))
    nothing = Panorama(torch.zeros_like(seen.hdr), torch.full_like(seen.depth, 4.0), torch.zeros_like(weight))
    torch.testing.assert_close(first_panorama(seen, weight)[:3], accumulate(nothing, seen, weight)[:3])


def test_gradients_pass_where_the_rule_keeps_the_weight():
    weight = torch.full((1, 1, 1, 2), 0.5, requires_grad=True)
    depth = torch.tensor([[[[1.0, 2.0]]]])
    conservative(weight, depth, torch.full_like(depth, 2.0), margin=0.25).sum().backward()
    assert weight.grad is not None
    assert weight.grad.flatten().tolist() == [1.0, 0.0]
