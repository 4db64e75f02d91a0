"""Rendered objects: geometry of the picture, light between objects, glass, previews, determinism."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from shading_reference import look_at, mirrored_rays, moved, paths, wall

from roomlight.camera import Intrinsics
from roomlight.compositing.light.lighting import LightSampler, ProbeSet
from roomlight.compositing.objects.materials import Material, diffuse, glass, glossy, mirror, rough_metal
from roomlight.compositing.objects.primitives import cube, plane, sphere
from roomlight.compositing.objects.textures import Texture
from roomlight.compositing.rendering import renderer
from roomlight.compositing.rendering.renderer import RenderedObjects, RenderSettings, render_objects
from roomlight.compositing.rendering.tracer import TracedObjects
from roomlight.conventions import linear_to_srgb
from roomlight.errors import ObjectError, OptionError

CAMERA = Intrinsics(60.0, 60.0, 32.0, 24.0, 64, 48)
POSE = look_at((0, 0, 2), (0, 0, 0))
FEW = paths(16)


def panorama(seed: int = 0, rows: int = 32) -> np.ndarray:
    small = np.random.default_rng(seed).random((4, 8, 3))
    return np.kron(small, np.ones((rows // 4, rows // 4, 1))).astype(np.float32)


def rendered(
    objects, light: ProbeSet | np.ndarray | float, quality: str | RenderSettings = FEW, pose=POSE, **more
) -> RenderedObjects:
    """Render objects under probes, under a panorama, or under even light."""
    if not isinstance(light, ProbeSet):
        light = ProbeSet.single(light if isinstance(light, np.ndarray) else np.full((16, 32, 3), light, np.float32))
    return render_objects(TracedObjects(objects), CAMERA, pose, light, quality=quality, **more)


def test_mirror_sphere_shows_the_panorama_itself() -> None:
    light, ball = ProbeSet.single(panorama()), sphere(0.5, mirror())
    picture, preview = (rendered([ball], light, quality) for quality in (paths(1), "preview"))
    _, mirrored, square = mirrored_rays(CAMERA, POSE, np.zeros(3), 0.5)
    hit = square > 0.1  # away from the outline
    exact = light.samplers[0].radiance(mirrored[hit])
    # the sphere is made of triangles: directions are off by up to 0.2 degrees, on a panorama of 5.6 degrees a pixel
    assert np.abs(preview.radiance[hit] - exact).mean() < 0.005
    assert np.abs(picture.radiance[hit] - exact).mean() < 0.08  # drawn anywhere in the pixel


def test_the_rim_of_a_mirror_has_no_dots_in_a_preview() -> None:
    """A pixel of the rim shows much of the room: its middle alone is any colour."""
    many, preview = (rendered([sphere(0.5, mirror())], panorama(), quality) for quality in (paths(1024), "preview"))
    inside = (many.alpha == 1).astype(np.uint8)
    rim = (inside > 0) & (cv2.erode(inside, np.ones((3, 3), np.uint8)) == 0)
    assert rim.sum() > 40
    assert np.abs(preview.radiance - many.radiance)[rim].mean() < 0.025  # 0.045 by the middles


def test_diffuse_sphere_under_constant_light_is_its_albedo() -> None:
    light = np.full((16, 32, 3), (1, 2, 3), np.float32)
    for quality, tolerance in (("preview", 0.002), (paths(64), 0.01)):
        picture = rendered([sphere(0.5, diffuse((0.8, 0.5, 0.2)))], light, quality)
        inside = picture.radiance[picture.alpha == 1]
        np.testing.assert_allclose(inside.mean(axis=0), [0.8, 1.0, 0.6], rtol=tolerance)


def test_glass_has_no_dark_dots_where_few_samples_miss_a_window() -> None:
    """16 samples that all miss it look free of noise: 133 pixels were too dark by their own noise alone."""
    light = np.full((32, 64, 3), 0.3, np.float32)
    light[4:24, 44:64] = 10.0
    few, whole = (rendered([sphere(0.5, glass())], light, paths(64, 6, least=least)).radiance for least in (16, 0))
    assert (few < 0.7 * whole).all(axis=2).sum() < 30


def test_a_mirror_without_noise_counts_as_one_also_with_more_samples() -> None:
    total, part = renderer._film(1), renderer._film(1)
    part.doubt[:] = -0.0
    for _ in range(2):
        renderer._accumulate(total, part, 0.5)
    assert np.signbit(total.doubt).all()


def test_pixels_without_noise_get_the_least_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mirror under smooth light needs all samples on its outline alone, a glossy sphere under lamps elsewhere too."""
    counts: list[int] = []
    traced = renderer._traced

    def counted(stage, view, first, samples):
        counts.append(len(view.column) * samples)
        return traced(stage, view, first, samples)

    monkeypatch.setattr(renderer, "_traced", counted)
    smooth = ProbeSet.single(cv2.GaussianBlur(panorama(), (0, 0), 3))
    shares = []
    for material, light in ((mirror(), smooth), (glossy(), ProbeSet.single(20 * panorama() ** 8))):
        pictures, taken = [], []
        for least in (16, 0):
            counts.clear()
            pictures.append(rendered([sphere(0.5, material)], light, paths(64, least=least)))
            taken.append(sum(counts))
        shown = [linear_to_srgb(picture.radiance[pictures[1].alpha == 1].clip(0, 1)) for picture in pictures]
        assert np.abs(shown[0] - shown[1]).mean() < 2 / 255
        assert np.abs(pictures[0].alpha - pictures[1].alpha).max() < 0.1  # a corner of a pixel that 16 points miss
        shares.append(taken[0] / taken[1])
    assert shares[0] < 0.5
    assert shares[1] > 1.05 * shares[0]


def test_neighbours_are_averaged_as_far_as_they_look_alike() -> None:
    """Smoothing takes noise from rough faces, and leaves mirrors and the borders of colours."""
    colours = {-0.26: (0.8, 0.2, 0.1), 0.26: (0.1, 0.2, 0.8)}
    pair = [moved(cube(0.5, rough_metal(0.5, colour)), x) for x, colour in colours.items()]
    qualities = paths(16), paths(16, smoothed=True)
    plain, smooth = (rendered([sphere(0.5, mirror())], panorama(), quality).radiance for quality in qualities)
    np.testing.assert_array_equal(smooth, plain)
    truth = rendered(pair, panorama(), paths(512))
    plain, smooth = (rendered(pair, panorama(), quality).radiance for quality in qualities)
    inside = truth.alpha == 1
    noisy = inside & np.any(plain != smooth, axis=-1)
    assert noisy.sum() > 100
    errors = [np.abs(radiance - truth.radiance)[noisy].mean() for radiance in (smooth, plain)]
    assert errors[0] < 0.6 * errors[1]
    np.testing.assert_allclose(smooth[inside].mean(0), plain[inside].mean(0), 0.01)


def test_same_inputs_and_seed_give_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    objects = [sphere(0.4, glossy()), moved(cube(0.4, glass()), 0.5)]
    first = rendered(objects, panorama(), seed=3)
    monkeypatch.setenv("ROOMLIGHT_THREADS", "1")
    second, other = (rendered(objects, panorama(), seed=seed) for seed in (3, 4))
    assert first.radiance.tobytes() == second.radiance.tobytes()
    assert first.radiance.tobytes() != other.radiance.tobytes()


def test_alpha_is_the_covered_share_of_each_pixel() -> None:
    picture = rendered([sphere(0.5, diffuse())], panorama(), paths(64, 2))
    outline = np.pi * (60 * 0.5 / np.sqrt(4 - 0.25)) ** 2
    assert picture.alpha.sum() == pytest.approx(outline, rel=0.005)
    edges = (picture.alpha > 0) & (picture.alpha < 1)
    assert 30 < edges.sum() < 150
    assert np.all(picture.radiance[picture.alpha == 0] == 0)
    assert np.all(picture.object_id[picture.alpha == 0] == -1)
    assert np.all(picture.depth_m[picture.alpha == 0] == 0)


@pytest.mark.parametrize("quality", ["preview", FEW])
def test_depth_is_along_the_optical_axis(quality) -> None:
    np.testing.assert_allclose(rendered([wall(diffuse(), -1)], panorama(), quality).depth_m, 3, rtol=1e-5)


def test_objects_shadow_each_other() -> None:
    light = np.zeros((32, 64, 3), np.float32)
    light[:6] = 1.0  # from above
    ground = plane(2.0, 2.0, diffuse((1.0, 1.0, 1.0)))
    above = look_at((0, 1.5, 2), (0, 0, 0))
    cover = moved(plane(0.8, 0.8, diffuse((0.0, 0.0, 0.0))), 0, 0.3)
    bare, shadowed = (rendered(objects, light, pose=above) for objects in ([ground], [ground, cover]))
    seen = (shadowed.object_id == 0) & (shadowed.alpha == 1)
    ratio = shadowed.radiance[seen].sum(axis=1) / bare.radiance[seen].sum(axis=1)
    assert ratio.min() < 0.4
    assert np.quantile(ratio, 0.9) == pytest.approx(1, abs=0.1)


def test_objects_reflect_each_other() -> None:
    red = moved(sphere(0.4, Material(base_colour=(0.0, 0.0, 0.0), specular=0.0, emissive=(5.0, 0.0, 0.0))), 0.9)
    picture = rendered([sphere(0.4, mirror()), red], 0.1)
    on_mirror = picture.radiance[picture.object_id == 0]
    assert on_mirror[:, 0].max() > 4.5
    assert on_mirror[:, 1].max() < 0.11


def test_mirrors_and_glass_leave_no_bright_dots_on_matte_ground() -> None:
    light = np.full((32, 64, 3), 0.2, np.float32)
    light[8, 20] = 1000.0  # a lamp of 6 degrees; without limits the brightest pixels are at 6 and 27 x the median
    ground = plane(2.0, 2.0, diffuse())
    above = look_at((0, 1.0, 2), (0, 0, 0))
    for material in (mirror(), glass()):
        picture = rendered([ground, moved(sphere(0.3, material), 0, 0.3)], light, paths(64, 6), above)
        matte = picture.radiance[(picture.object_id == 0) & (picture.alpha == 1)][:, 1]
        assert matte.max() < 5 * np.median(matte), material


def test_closed_box_of_mirrors_ends_paths() -> None:
    picture = rendered([cube(1.0, mirror())], panorama(), pose=look_at((0.1, 0.05, 0.1), (0, 0, -1)))
    assert picture.alpha.min() == 1
    assert picture.radiance.max() == 0  # no light gets in


@pytest.mark.parametrize("quality", [FEW, "preview"])
def test_glass_shows_the_background_behind_it(quality) -> None:
    def background(directions: np.ndarray) -> np.ndarray:
        seen = np.tile(np.array([3.0, 0, 0], np.float32), (len(directions), 1))
        seen[directions[:, 0] < 0] = np.nan  # not in the frame
        return seen

    picture = rendered([wall(glass(ior=1.0))], 0.25, quality, background=background)
    assert picture.alpha.min() == 1
    np.testing.assert_allclose(picture.radiance[:, 40:], np.broadcast_to([3, 0, 0], (48, 24, 3)), rtol=1e-4)
    np.testing.assert_allclose(picture.radiance[:, :24], 0.25, rtol=1e-4)


def test_glass_shows_the_light_of_the_nearest_probe_beyond_the_frame() -> None:
    probes = [
        LightSampler(np.full((16, 32, 3), value, np.float32), (x, 0.0, 0.0)) for value, x in ((1, -9.0), (3, 9.0))
    ]

    def background(directions: np.ndarray) -> np.ndarray:
        return np.full((len(directions), 3), np.nan, np.float32)

    def shown(x: float) -> RenderedObjects:
        pose, pane = look_at((x, 0, 2), (x, 0, 0)), moved(wall(glass(ior=1.0)), x)
        return rendered([pane], ProbeSet(probes), pose=pose, background=background)

    assert [float(np.median(shown(x).radiance)) for x in (-9.0, 0.0, 9.0)] == pytest.approx([1, 2, 3], rel=0.1)


@pytest.mark.parametrize("quality", ["preview", paths(64, 8)])
def test_glass_tints_light_once_and_thin_walls_do_not_bend_it(quality) -> None:
    solid = glass(tint=(0.25, 0.5, 1.0))
    thin = replace(solid, is_thin=True, one_sided=True)
    for shape in (sphere(0.5, solid), sphere(0.5, thin), wall(replace(thin, one_sided=False)), wall(thin)):
        middle = rendered([shape], 1, quality).radiance[22:26, 30:34].mean((0, 1))
        np.testing.assert_allclose(middle, [0.28, 0.52, 1.0], atol=0.02)  # 4 to 8 % is reflected
    light = np.zeros((32, 64, 3), np.float32)
    light[:16] = 1
    above = rendered([sphere(0.5, replace(thin, base_colour=(1.0, 1.0, 1.0)))], light, quality).radiance[:, 32, 1]
    assert above[14] > 0.9
    assert above[34] < 0.2


def test_more_glass_than_paths_can_cross_is_not_black() -> None:
    nested = [cube(0.2 + 0.15 * k, glass()) for k in range(4)]  # eight surfaces, of which paths cross four
    picture = rendered(nested, 1)
    covered = picture.radiance[picture.alpha == 1]
    assert covered.mean() == pytest.approx(1, rel=0.02)  # nothing absorbs the even light


def test_glass_on_a_plate_in_the_dark_is_black() -> None:
    assert (rendered([moved(plane(2.0, 2.0), 0, -0.5), sphere(0.4, glass())], 0).radiance == 0).all()


def test_glass_sphere_turns_the_light_upside_down() -> None:
    light = np.zeros((32, 64, 3), np.float32)
    light[:16] = (0, 0, 1)  # blue above
    light[16:] = (0, 1, 0)
    picture = rendered([sphere(0.5, glass(1.5))], light, paths(64, 8))
    upper, lower = picture.radiance[18, 32], picture.radiance[30, 32]
    assert upper[1] > 0.8
    assert upper[2] < 0.2
    assert lower[2] > 0.8


def test_a_small_glowing_ball_lights_a_plate_evenly_by_its_solid_angle() -> None:
    ball = moved(sphere(0.02, replace(diffuse((0.0, 0.0, 0.0)), emissive=(400.0, 200.0, 0.0))), 0, 0.4)
    lit = rendered([plane(2.0, 2.0, diffuse((0.5, 0.5, 0.5))), ball], 0, paths(64), look_at((0, 1.2, 0), (0, 0, 0)))
    x, z = (CAMERA.rays()[..., axis] * 1.2 for axis in (0, 1))
    exact = 0.5 * 400 * 0.02**2 * 0.4 / (x**2 + z**2 + 0.4**2) ** 1.5
    ratio = lit.radiance[lit.object_id == 0][:, 0] / exact[lit.object_id == 0]
    assert ratio.mean() == pytest.approx(1, abs=0.02)
    assert ratio.std() < 0.2  # 4.6 by rays that meet it by chance
    red, green, blue = lit.radiance[lit.object_id == 0].mean(axis=0)
    assert (green / red, blue) == pytest.approx((0.5, 0), rel=1e-4)


@pytest.mark.parametrize("material", [diffuse((1.0, 1.0, 1.0)), glossy((1.0, 1.0, 1.0)), rough_metal(0.5), glass()])
@pytest.mark.parametrize("opacity", [1.0, 0.5])
def test_a_furnace_of_glowing_walls_is_as_bright_as_one_of_the_panorama(material: Material, opacity: float) -> None:
    """The walls are a hundred times as bright as the panorama, which shows between them."""
    glow = replace(diffuse((0.0, 0.0, 0.0)), opacity=opacity, emissive=(100.0, 100.0, 100.0))
    walls = [sphere(2.5 + k, glow) for k in range(3)]
    lit = rendered([sphere(0.5, material), *walls], 1, paths(16, 12))
    inside = lit.radiance[lit.object_id == 0]
    np.testing.assert_allclose(inside.mean(axis=0), 100 - 99 * (1 - opacity) ** 3, rtol=0.015)


@pytest.mark.parametrize("quality", ["preview", paths(64, 3)])
def test_cut_out_shows_what_is_behind(quality) -> None:
    hole = Material(specular=0.0, opacity=0.3, alpha_cutoff=0.5)
    behind = sphere(0.4, diffuse())
    alone, covered = (rendered(some, panorama(), quality) for some in ([behind], [behind, wall(hole, 1)]))
    assert covered.alpha[0, 0] == 0
    assert covered.object_id[24, 32] == 0
    np.testing.assert_allclose(covered.alpha, alone.alpha, atol=0.05)
    # shadow rays take the wall for solid
    assert covered.depth_m[24, 32] == pytest.approx(alone.depth_m[24, 32], rel=1e-3)


@pytest.mark.parametrize(("by_triangle", "least", "most"), [(False, 0.0, 0.05), (True, 0.1, 1.0)])
def test_previews_average_textures_finer_than_pixels(by_triangle: bool, least: float, most: float) -> None:
    noise = Texture.from_linear(np.random.default_rng(0).random((1024, 1024, 3)).astype(np.float32))
    fine = Material((1.0, 1.0, 1.0), specular=0.0, base_colour_texture=replace(noise, by_triangle=by_triangle))
    objects = [wall(fine), sphere(0.1, mirror())]
    shown = rendered(objects, 1.0, "preview").radiance[:10]
    assert least < shown.std() < most
    assert shown.mean() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(("hidden_alpha", "colour"), [(0, 65535), (65535, 32768)])
def test_levels_of_textures_do_not_mix_in_what_is_hidden(hidden_alpha: int, colour: int) -> None:
    texels = np.full((4, 4, 4), 65535, np.uint16)
    texels[:, ::2] = 0, 0, 0, hidden_alpha  # leaves are often saved on transparent black
    assert Texture(texels).levels[1][..., :3] == pytest.approx(colour, abs=1)


def test_a_cut_out_is_there_where_its_alpha_is_its_cutoff() -> None:
    opaque = Texture.from_srgb8(np.full((7, 5, 4), 255, np.uint8))
    whole = wall(Material(base_colour_texture=opaque, opacity=0.5, alpha_cutoff=0.5))
    assert rendered([whole], 1.0, "preview").alpha.min() == 1


@pytest.mark.parametrize("quality", ["good", paths(256, 8)])
def test_a_cut_out_of_which_nothing_is_left_takes_no_light(quality) -> None:
    grey = diffuse((0.8, 0.8, 0.8))
    back, gone = cube(1.0, grey), cube(0.6, replace(grey, opacity=0.0, alpha_cutoff=0.5))
    objects = [moved(back, 0, 0, -0.5), moved(gone, 0, 0, 0.35)]
    bare, behind = (rendered(some, panorama(), quality).radiance[18:30, 26:38] for some in (objects[:1], objects))
    np.testing.assert_allclose(behind.mean((0, 1)), bare.mean((0, 1)), rtol=0.02)
    assert behind.std() < 1.5 * bare.std() + 0.02  # as smooth


def test_half_opacity_covers_half() -> None:
    for quality in ("preview", paths(64, 3)):
        picture = rendered([wall(Material(opacity=0.5))], panorama(), quality)
        assert picture.alpha.mean() == pytest.approx(0.5, abs=0.01)


def test_light_changes_over_a_long_object() -> None:
    lights = {(-1.0, 0.0, 0.0): 1.0, (1.0, 0.0, 0.0): 3.0}
    probes = ProbeSet([LightSampler(np.full((8, 16, 3), level), place) for place, level in lights.items()])
    beam = plane(2.0, 0.4, diffuse((1.0, 1.0, 1.0)))
    above = look_at((0, 2, 0), (0, 0, 0))
    for quality in ("preview", FEW):
        row = rendered([beam], probes, quality, above).radiance[24, :, 1]
        assert row[4] == pytest.approx(1, abs=0.1)
        assert row[32] == pytest.approx(2, abs=0.15)
        assert row[59] == pytest.approx(3, abs=0.1)


@pytest.mark.parametrize("quality", ["preview", paths(16, 6)])
def test_mirrors_and_glass_show_a_light_of_their_own(quality) -> None:
    lit, shown = (LightSampler(np.full((8, 16, 3), level)) for level in (2.0, 1.0))

    def mean(material: Material) -> float:
        picture = rendered([sphere(0.5, material)], ProbeSet([lit], mirrored=[shown]), quality)
        return float(picture.radiance[picture.alpha == 1].mean())

    assert mean(mirror()) == pytest.approx(1, rel=0.01)
    assert mean(glass()) <= 1.01
    assert mean(diffuse((1.0, 1.0, 1.0))) == pytest.approx(2, rel=0.02)
    assert mean(rough_metal()) > 1.5


def test_what_mirrors_show_is_resampled_and_must_be_at_the_same_positions() -> None:
    fine, coarse = (LightSampler(np.full((rows, 2 * rows, 3), rows, np.float32)) for rows in (16, 8))
    assert ProbeSet([fine], mirrored=[coarse]).environment.mirrored.shape == (1, 16, 32, 3)
    assert ProbeSet([fine], mirrored=[coarse]).panoramas.mirrored.mean() == 8
    elsewhere = LightSampler(fine.panorama, (1.0, 0.0, 0.0))
    for others in ([elsewhere], [fine, fine], []):
        with pytest.raises(OptionError, match="at the positions of the others"):
            ProbeSet([fine], mirrored=others)


def test_normal_texture_tilts_the_surface() -> None:
    tilted = np.zeros((1, 1, 3), np.float32)
    tilted[0, 0] = 0.5 + 0.5 * np.array([np.sin(np.pi / 4), 0, np.cos(np.pi / 4)])  # 45 degrees toward growing u = +x
    light = np.zeros((32, 64, 3), np.float32)
    light[:, 28:36] = 1  # around +x
    above = look_at((0, 3, 0.001), (0, 0, 0))
    plain = diffuse((1.0, 1.0, 1.0))
    bent = replace(plain, normal_texture=Texture.from_linear(tilted))
    before, after = (
        rendered([plane(1.0, 1.0, material)], light, "preview", above).radiance[24, 32, 0] for material in (plain, bent)
    )
    assert after > 1.5 * before


def test_objects_behind_the_camera_are_not_drawn_and_around_it_are() -> None:
    assert rendered([moved(sphere(0.3), 0, 0, 5)], panorama()).alpha.max() == 0
    assert rendered([sphere(5.0)], panorama(), paths(1, 2)).alpha.min() == 1


@pytest.mark.slow  # Open Image Denoise loads for seconds
def test_final_is_denoised_only_where_objects_are() -> None:
    pytest.importorskip("pyoidn")
    light = panorama()
    light[5, 9] = 300
    qualities = paths(4, 3), replace(paths(4, 3), denoised=True), paths(512, 3)
    noisy, clean, truth = (rendered([sphere(0.5, rough_metal())], light, quality) for quality in qualities)
    assert np.all(clean.radiance[clean.alpha == 0] == 0)
    inside = truth.alpha == 1
    errors = [np.abs(one.radiance - truth.radiance)[inside].mean() for one in (clean, noisy)]
    assert errors[0] < errors[1]


def test_unknown_qualities_and_empty_scenes_are_refused() -> None:
    for quality in ("best", paths(3), paths(16, 0), paths(16, least=3)):
        with pytest.raises(OptionError):
            rendered([sphere(0.1)], 1, quality)
    with pytest.raises(ObjectError, match="one object at least"):
        TracedObjects([])


def test_rays_meet_and_miss_objects() -> None:
    scene = TracedObjects([sphere(0.5), moved(cube(0.5), 2.0)])
    origins = np.array([[0, 0, 2.0], [2, 0, 2], [0, 3, 2]], np.float32)
    directions = np.tile(np.array([0, 0, -1], np.float32), (3, 1))
    hits = scene.trace(origins, directions)
    assert scene.surfaces.object_id[hits.face[:2]].tolist() == [0, 1]
    assert hits.face[2] == -1
    np.testing.assert_allclose(hits.distance_m, [1.5, 1.75, np.inf], rtol=1e-3)
    assert scene.blocked(origins, directions).tolist() == [True, True, False]
    assert scene.blocked(origins, directions, np.full(3, 1.6, np.float32)).tolist() == [True, False, False]


@pytest.mark.parametrize(("one_sided", "share"), [(True, 0.4), (False, 0.64)])
@pytest.mark.parametrize("quality", ["preview", paths(64, 3)])
def test_opacity_covers_evenly_and_once_where_backs_are_not_there(quality, one_sided: bool, share: float) -> None:
    ball = sphere(0.5, Material(opacity=0.4, one_sided=one_sided))
    alpha = rendered([ball], 1.0, quality).alpha[20:28, 28:36]
    np.testing.assert_allclose(alpha, share, atol=1 / 64 + 1e-6)
