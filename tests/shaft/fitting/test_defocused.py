"""A shaft whose two edges' blurs meet, and the averaging of pixels in bins."""

import itertools

import numpy as np
import pytest
from benchmarks.defocused import CAMERA as BLURRED
from benchmarks.defocused import bow_score, drawn, scores
from scipy.integrate import quad
from scipy.special import ndtr

from pivometer.cameras import Camera
from pivometer.errors import ShaftNotFoundError
from pivometer.shaft.edges import fit_edges
from pivometer.shaft.fitting.profile import limb
from pivometer.shaft.fitting.rungs import IN, LIMB, OUT, OUT_RAMP, RAMP, Blur, Rung, evaluate, solve
from pivometer.shaft.fitting.samples import Samples, binned
from pivometer.shaft.seed import ShaftSeed

CAMERA = Camera("left", 320, 240, [400.0, 400.0], [160.0, 120.0], [0.0, 0.0])
SHAFT, NOISE = 90.0, 3.0


def blurred_shaft(rng, *, width_px=17.0, blur_px=(2.2, 3.4), tilt=0.12):
    """A shaft before a background that goes from much brighter to much darker than it.

    Returns the image and the edges' ends, shape (2, 2, 2); the blur grows along the shaft.
    """
    y, x = np.mgrid[0:240, 0:320].astype(float)
    middle = 158.3 + tilt * (y - 120)
    across = (x - middle) / np.hypot(1, tilt)
    blur = np.interp(y, [0, 239], blur_px)
    cover = ndtr((across + width_px / 2) / blur) - ndtr((across - width_px / 2) / blur)
    behind = 190 - 160 * y / 239 + 0.1 * (x - 160)
    image = behind + cover * (SHAFT - behind) + NOISE * rng.standard_normal(y.shape)
    ends = np.array([8.0, 231.0])
    half = width_px / 2 * np.hypot(1, tilt)
    edges = [
        [[158.3 + tilt * (end - 120) + side * half, end] for end in ends] for side in (-1.0, 1.0)
    ]
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), np.array(edges)


def test_edges_whose_blurs_meet_are_found_before_a_background_that_crosses_their_level():
    rng = np.random.default_rng(5)
    scores = []
    for _ in range(6):
        image, truth = blurred_shaft(rng)
        seed = ShaftSeed(truth + rng.uniform(-1, 1, (2, 2, 2)) * [1, 0])
        found = fit_edges(image, CAMERA, seed)
        assert found.blur_px == pytest.approx(2.8, abs=0.2)
        for edge, (start, end) in enumerate(truth):
            along = (end - start) / np.hypot(*(end - start))
            outward = np.array([along[1], -along[0]]) * (-1 if edge else 1)
            off = (found.points_px[edge].mean(axis=0) - start) @ outward
            scores.append(off / found.sigma_px[edge])
        assert found.sigma_px.max() < 0.2
    # 12 scores, of which 1 in 400 would be over 3 if the stated uncertainty were all noise.
    assert np.abs(scores).max() < 3


def test_bent_blurred_shafts_have_their_nearest_lines_and_bows_within_what_is_stated():
    rng = np.random.default_rng(8)
    kinds = ({}, {"side": 0.15}, {"round_": True}, {"crossing": True, "spots": True})
    for kind in kinds:
        shaft = drawn(rng, bow_px=(1.5, 3.0), **kind)
        found = fit_edges(shaft.image, BLURRED, ShaftSeed(shaft.seed_px))
        error, sigma = scores(shaft, found)
        # Six numbers, of which the three of an edge are one line's: 1 in 500 is beyond 3.5.
        assert np.abs(error / sigma).max() < 3.5
        assert sigma[:, 1].max() < 0.5
        off, u = bow_score(shaft, found)
        assert abs(off) < 4 * u
        assert any(warning.startswith("bent") for warning in found.warnings)


def test_a_shaft_without_noise_bends_and_is_lit_as_drawn():
    y, x = np.mgrid[0:240, 0:320].astype(float)
    t = (y - 119.5) / 111.5
    across, half, blur = x - 158.3 - 0.1 * (y - 120) + 1.8 * (t**2 - 1 / 3), 8.0, 2.7 + 0.4 * t
    image = 170 + 20 * t
    bounds = np.linspace(-half, half, 33)
    for low, high in itertools.pairwise(bounds):
        strip = ndtr((across - low) / blur) - ndtr((across - high) / blur)
        image += (SHAFT * (1 + 0.1 * (low + high) / 2 / half) - 170 - 20 * t) * strip
    ends = np.array([8.0, 231.0])
    edges = np.array([[[158.3 + 0.1 * (e - 120) + s * half, e] for e in ends] for s in (-1, 1)])
    seed = ShaftSeed(edges + np.array([[[1.5, 0], [-1.0, 0]], [[2.0, 0], [1.0, 0]]]))
    found = fit_edges(image, CAMERA, seed)
    for truth, points in zip(edges, found.points_px, strict=True):
        foot = np.interp(points[:, 1], truth[:, 1], truth[:, 0])
        # The blur's square is no parabola here, and pixels are boxes: a fiftieth of a blur each.
        assert np.abs(points[:, 0] - foot).max() < 0.06
    seen = np.ptp(found.points_px[:, :, 1]) / 223
    assert -found.curvature_px[0] == pytest.approx(1.8 * seen**2, abs=0.06)
    assert found.curvature_px[1] == pytest.approx(1.8 * seen**2, abs=0.06)


def chunks(rng, parameters):
    """Pixels beside both edges of a shaded shaft that lies at `parameters`, in four chunks."""
    x = rng.uniform(-9, 7, (4, 600))
    lever = rng.uniform(-0.05, 0.05, (4, 600)) + np.array([[-0.5], [0.5], [-0.5], [0.5]])
    edge = np.array([0, 0, 1, 1])
    samples = Samples(
        grey=np.zeros_like(x),
        x_px=x,
        lever=lever,
        count=np.ones_like(x),
        scale=np.ones((4, 1)),
        half_px=np.full((4, 1), 14.0),
        edge=edge,
    )
    away = samples.moved(parameters)
    blur = parameters[4]
    inside = 60 + 90 * limb(away, blur, samples.half_px)[0]
    grey = 20 + (inside - 20) * (1 - ndtr(away / blur)) + rng.standard_normal(x.shape)
    return Samples(grey, x, lever, samples.count, samples.scale, samples.half_px, edge)


def test_bins_tell_what_their_pixels_tell():
    rng = np.random.default_rng(3)
    samples = chunks(rng, np.array([0.08, -0.05, -0.1, 0.04, 0.85]))
    rung, blur = Rung(8.0, 6.0, (OUT, OUT_RAMP, IN, RAMP, LIMB)), Blur()
    start = np.array([0.0, 0.0, 0.0, 0.0, 0.8])
    whole = solve([evaluate(samples, rung, start, 1.0)], 1.0, blur, start)
    few = binned(samples, start, (-9.0, 7.0))
    assert few.grey.size < samples.grey.size / 4
    parts = solve([evaluate(few, rung, start, 1.0)], 1.0, blur, start)
    sigma = np.sqrt(whole[1].diagonal())
    # Bins that cross a window's end and the curvature inside bins move steps by parts of a sigma.
    assert (np.abs(parts[0] - whole[0]) < 0.5 * sigma).all()
    np.testing.assert_allclose(np.sqrt(parts[1].diagonal()), sigma, rtol=0.1)


@pytest.mark.parametrize("half_px", [7.3, 14.0, 14.85])
def test_tables_give_the_blurred_limb(half_px):
    blur = 0.83
    x = np.linspace(-5, 3, 9)[None]
    value, slope, _ = limb(x, blur, np.array([[half_px]]))

    def blurred(at: float) -> float:
        def term(t: float) -> float:
            bell = np.exp(-0.5 * ((at - t) / blur) ** 2) / (np.sqrt(2 * np.pi) * blur)
            return float(np.sqrt(max(1 - (1 + t / half_px) ** 2, 0.0)) * bell)

        low = max(at - 8 * blur, -2 * half_px)
        return quad(term, low, 0.0, limit=200)[0] if low < 0 else 0.0

    exact = np.array([blurred(at) for at in x[0]])
    # From tables 10 % of the half width and 0.02 px apart it is up to 0.05 px to the nearest blur,
    # whose square times half the second derivative by the blur, 0.15 / px², is left over.
    np.testing.assert_allclose(value[0], exact, atol=2e-4)
    apart = np.array([(blurred(a + 1e-3) - blurred(a - 1e-3)) / 2e-3 for a in x[0]])
    np.testing.assert_allclose(slope[0], apart, atol=3e-3)


def test_windows_of_single_edges_are_not_believed_where_blurs_meet(monkeypatch):
    """They are taken where no model of both edges holds, and then see the other edge's blur."""
    rng = np.random.default_rng(6)
    monkeypatch.setattr("pivometer.shaft.edges.fit_defocused", lambda *_: None)
    for _ in range(4):
        image, truth = blurred_shaft(rng)
        with pytest.raises(ShaftNotFoundError, match=r"their blurs meet.*focus the camera"):
            fit_edges(image, CAMERA, ShaftSeed(truth + rng.uniform(-1, 1, (2, 2, 2)) * [1, 0]))
