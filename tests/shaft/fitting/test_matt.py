"""The matt shading of a whole width, against scenes drawn by dense supersampling."""

import numpy as np
import pytest
from tests.shaft.rendering import NOISE, camera_of, render

from pivometer.shaft.edges import fit_edges
from pivometer.shaft.fitting import matt
from pivometer.shaft.fitting.choice import Said, spread_if_holds
from pivometer.shaft.fitting.lines import edge_lines, halves_px
from pivometer.shaft.fitting.matt import fit_matt
from pivometer.shaft.fitting.rungs import Blur
from pivometer.shaft.fitting.samples import Samples
from pivometer.shaft.fitting.strip import CHUNK_ROWS
from pivometer.shaft.fitting.view import ShaftView
from pivometer.shaft.seed import ShaftSeed

BLUR_PX = float(np.sqrt(0.7**2 + 1 / 12))


def matt_shaft(**other):
    """A tapered shaft of 44 px before dark, lit from all over and a little more from one side."""
    look = {"limb": 0.6, "side_light": 0.1, "taper": 0.05, "width_px": 44.0}
    return render(camera_of(), **(look | other))


def fitted(scene, image, noise=NOISE):
    """What the whole width says when told the true lines."""
    view = ShaftView.of(image, scene.camera, edge_lines(scene.seed_px, scene.camera))
    first, second = view.maps
    rows = max(len(first.rows), len(second.rows)) + abs(int(first.rows[0] - second.rows[0]))
    every = np.ones((2, -(-rows // CHUNK_ROWS) * CHUNK_ROWS))
    start = np.array([0.01, 0.005, -0.01, 0.005, 0.77])
    return fit_matt(view, every, start, noise=noise, blur=Blur())


def test_derivatives_by_all_parameters():
    rng = np.random.default_rng(1)
    x = np.sort(rng.uniform(-15, 6, (4, 80)))[:, ::-1]
    samples = Samples(
        grey=rng.uniform(20, 180, x.shape),
        x_px=x,
        lever=np.array([-0.5, 0.5, -0.5, 0.5])[:, None] + 0.001 * x,
        count=rng.integers(1, 9, x.shape).astype(float),
        scale=np.array([1.0, 1.02, 0.98, 1.0])[:, None],
        half_px=np.array([14.0, 14.6, 14.1, 14.7])[:, None],
        edge=np.array([0, 0, 1, 1]),
    )
    at = np.array([0.05, -0.03, -0.04, 0.02, 0.836])
    levels = rng.uniform(20, 100, (2, matt.LEVELS))

    def seen(parameters):
        values = matt._terms(samples, parameters).values
        own = [np.hstack([levels[:, 2 * e : 2 * e + 2], levels[:, 4:]]) for e in range(2)]
        return np.stack([np.einsum("ck,ckp->cp", o, v) for o, v in zip(own, values, strict=True)])

    found = matt._derivatives(samples, matt._terms(samples, at), levels)
    for k in range(5):
        step = np.zeros(5)
        step[k] = 1e-3
        expected = np.moveaxis(seen(at + step) - seen(at - step), 0, 1) / 2e-3
        # Tables of limbs are continued to first order by the blur.
        np.testing.assert_allclose(found[:, k], expected, atol=0.01 * np.abs(expected).max())


@pytest.mark.parametrize("angle_deg", [83.0, 62.0])
def test_a_matt_shaft_is_fitted_exactly(angle_deg):
    scene = matt_shaft(angle_deg=angle_deg)
    found = fitted(scene, scene.clean, noise=1.0)
    assert found is not None
    # A pixel is a box, whose fourth moment no Gaussian has; ten samples a pixel draw it to 0.001.
    np.testing.assert_allclose(found.parameters[:4], 0, atol=0.0015)
    assert found.parameters[4] == pytest.approx(BLUR_PX, abs=0.005)


def test_errors_are_as_stated():
    rng = np.random.default_rng(8)
    scene = matt_shaft()
    scores, stated = [], []
    for _ in range(16):
        found = fitted(scene, scene.with_noise(NOISE, rng))
        assert found is not None
        assert max(found.misfits) < 3
        sigma = np.sqrt(found.covariance.diagonal()[:4])
        scores.append(found.parameters[:4] / sigma)
        stated.append(sigma[[0, 2]])
    # An rms of 64 has a relative standard deviation of 1/√128; three are 1.27.
    assert 1 / 1.27 < np.sqrt(np.mean(np.square(scores))) < 1.27
    assert np.max(stated) < 0.006  # 8 bits, noise 2, 240 rows; windows of 12 px state 0.007


@pytest.mark.parametrize("uneven", [0.0, -1.0])
def test_what_no_test_sees_is_in_the_stated_interval(uneven):
    # A grey level of a second harmonic, 0.6 % of the range, moves them by 0.014 and 0.008 px.
    rng = np.random.default_rng(12)
    scene = matt_shaft(uneven=uneven)
    scores, kinds = [], []
    for _ in range(8):
        image = np.rint(scene.with_noise(NOISE, rng)).astype(np.uint8)
        edges = fit_edges(image, scene.camera, ShaftSeed(scene.seed_px))
        kinds.append(edges.shading)
        scores.append(scene.offsets_px(edges.points_px).mean(axis=1) / edges.sigma_px)
    assert kinds.count("matt") >= 4
    assert np.sqrt(np.mean(np.square(scores))) < 1.53  # of 16: 1/√32, three times


@pytest.mark.parametrize(
    "look",
    [
        {"oblique_deg": 50.0},
        {"gloss_at": 0.45},
        {"lamp_deg": 50.0},  # what it does not reach is another function
        {"uneven": 3.0},
    ],
)
def test_what_is_not_matt_is_not_taken_for_it(look):
    scene = matt_shaft(**look)
    image = np.clip(np.rint(scene.with_noise(NOISE, np.random.default_rng(2))), 0, 255)
    edges = fit_edges(image.astype(np.uint8), scene.camera, ShaftSeed(scene.seed_px))
    assert edges.shading != "matt"


def test_an_answer_holds_if_less_certain_windows_agree():
    own = Said(0.0, 0.003, 0.0)
    near, far = Said(0.010, 0.005, 1.0), Said(0.030, 0.005, 1.0)
    # 0.010² less what noise explains, 0.005² − 0.003².
    assert spread_if_holds(own, [near]) == pytest.approx(np.sqrt(0.010**2 - 0.004**2))
    assert spread_if_holds(own, [Said(0.001, 0.005, 1.0)]) == 0.0
    assert spread_if_holds(own, [near, far]) is None
    assert spread_if_holds(own, [near, far._replace(misfit=9.0)]) is not None
    assert spread_if_holds(own._replace(misfit=9.0), [near]) is None
    assert spread_if_holds(own, []) is None


def test_half_the_width_at_places_along_each_edge():
    scene = matt_shaft(angle_deg=62.0)
    lines = edge_lines(scene.seed_px, scene.camera)
    # Where the image cuts them off, their middles stand at different places along the shaft.
    lever = np.array([[[-1.0], [0.0], [0.6]]] * 2)
    half = halves_px(lines, lever)
    for edge, (own, other) in enumerate((lines, lines[::-1])):
        apart = (own.at(lever[edge, :, 0]) - other.middle_px) @ other.outward
        np.testing.assert_allclose(half[edge, :, 0], np.abs(apart) / 2, rtol=1e-9)
