"""The shading of a whole width, against profiles summed over a fine grid."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from pivometer.shaft.fitting.glossy import Found, fit_glossy, followed
from pivometer.shaft.fitting.glossy_model import LEVELS, Model, Profile, angles, rough
from pivometer.shaft.fitting.rim import rim
from pivometer.shaft.fitting.rungs import Blur

STEP_PX, BIN_PX = 0.01, 0.25
HALVES_PX = np.array([17.0, 18.0])
LEVERS = np.array([-0.5, 0.5])
ROWS = 60
BLUR_PX = 0.8
TRUTH = np.array([0.13, -0.06, -0.08, 0.05, BLUR_PX])


def diffuse_and_one_highlight(angle):
    return 60 + 20 * np.sin(angle) + 50 * np.cos(angle) + 80 * np.exp(-(((angle - 0.9) / 0.3) ** 2))


def oblique_metal(angle):
    lit = np.clip(np.cos(angle - 0.8), 0, None)
    return 70 + 60 * lit + 90 * lit**6


def image_of_a_window(angle):
    """A matt shaft that mirrors a window up to 72° from its axis, blurred by 3°."""
    away = np.abs(np.degrees(angle) - 62)
    return 60 + 60 * np.cos(angle) + 80 * np.clip((10 - away) / 3 + 0.5, 0, 1)


def profile_of(shading, noise, rng):
    """A profile whose edges are at TRUTH from where they are thought to be."""
    x = np.arange(-26, 26, STEP_PX) + STEP_PX / 2
    greys, distances = [], []
    for half, lever in zip(HALVES_PX, LEVERS, strict=True):
        first, second = half + TRUTH[[0, 2]] + TRUTH[[1, 3]] * lever
        xi = np.clip((2 * x - first + second) / (first + second), -1, 1)
        cover = np.clip(np.minimum(first - x, second + x) / STEP_PX + 0.5, 0, 1)
        sharp = 20 + (shading(np.arcsin(xi)) - 20) * cover
        fine = gaussian_filter1d(sharp, BLUR_PX / STEP_PX, truncate=6)
        away = np.arange(6.0, -half, -BIN_PX)
        places = np.concatenate([half + away, -half - away])
        greys.append(np.interp(places, x, fine))
        distances.append(away)
    count = max(len(away) for away in distances)
    grey, x_px, number = np.zeros((3, 2, 2 * count))
    for part, (levels, away) in enumerate(zip(greys, distances, strict=True)):
        for edge in range(2):
            at = slice(edge * count, edge * count + len(away))
            own = levels.reshape(2, -1)[edge]
            grey[part, at] = own + rng.normal(0, noise / np.sqrt(ROWS * BIN_PX), len(own))
            x_px[part, at], number[part, at] = away, ROWS * BIN_PX
    return Profile(
        grey=grey,
        count=number,
        x_px=x_px,
        edge=np.repeat([0, 1], count),
        half_px=np.repeat(HALVES_PX[:, None], 2, axis=1),
        lever=np.repeat(LEVERS[:, None], 2, axis=1),
        scale=np.ones((2, 2)),
        noise=noise,
    )


@pytest.mark.parametrize("half", [[], [-1.6]])
def test_derivatives_by_all_parameters(half):
    profile = profile_of(oblique_metal, 0.0, np.random.default_rng(0))
    root = np.sqrt(profile.count) / 2
    model = Model(profile, Blur(), root, angles(90), 5 * rough(90), lamp=bool(half))
    at = np.array([0.1, -0.03, -0.05, 0.04, 0.9, 0.7, -1.2, 0.05, *half])

    def terms(parameters):
        seen, lobe = model.seen(parameters), model.highlight(parameters)
        return model.terms(seen, model.outside(seen, parameters[4]).values, lobe.values)

    _, levels, _ = model.solved(terms(at))
    assert len(levels) > 2 * LEVELS
    seen, lobe = model.seen(at), model.highlight(at)
    found = model.jacobian(at, seen, model.outside(seen, at[4]), lobe, levels)
    for k in range(len(at)):
        step = np.zeros(len(at))
        step[k] = 1e-4
        expected = (terms(at + step) - terms(at - step)) @ levels / 2e-4
        np.testing.assert_allclose(found[:, k], expected, atol=1e-5 * np.abs(expected).max())


def test_shading_of_the_model_is_fitted_exactly():
    profile = profile_of(diffuse_and_one_highlight, 0.0, np.random.default_rng(0))
    found = fit_glossy(profile, 2.0, Blur(), 0.85)
    assert found is not None
    # The grid on which the profile is summed has steps of 0.01 px.
    np.testing.assert_allclose(found.parameters, TRUTH, atol=0.002)


@pytest.mark.parametrize("shading", [diffuse_and_one_highlight, oblique_metal, image_of_a_window])
def test_errors_are_as_stated(shading):
    rng = np.random.default_rng(5)
    contrast = np.array([0.5, 0.0, -0.5, 0.0, 0.0])
    scores = []
    for _ in range(16):
        found = fit_glossy(profile_of(shading, 2.0, rng), 2.0, Blur(), 0.85)
        assert found is not None
        assert found.misfit < 5
        sigma = np.sqrt(contrast @ found.covariance @ contrast)
        scores.append(contrast @ (found.parameters - TRUTH) / sigma)
    # An rms of 16 has a relative standard deviation of 1/√32; three are 1.53.
    assert np.sqrt(np.mean(np.square(scores))) < 1.53


def test_a_highlight_beyond_the_limb_is_not_taken_for_a_likelier_one_before_it():
    def grazing(angle):
        lit = np.clip(np.cos(angle - np.radians(62)), 0, None)
        return 70 + 60 * lit + 90 * lit**12.4

    rng = np.random.default_rng(1)
    contrast = np.array([0.5, 0.0, -0.5, 0.0, 0.0])
    for _ in range(3):
        found = fit_glossy(profile_of(grazing, 2.0, rng), 2.0, Blur(), 0.85)
        assert found is not None
        # One beyond the limb leaves the centre three times less certain.
        sigma = np.sqrt(contrast @ found.covariance @ contrast)
        assert sigma < 0.04
        assert abs(contrast @ (found.parameters - TRUTH)) < 3 * sigma


def test_what_a_mirroring_rim_moves_is_told():
    plain, share = diffuse_and_one_highlight, 0.05
    levels = plain(np.pi / 2), plain(-np.pi / 2)

    def mirroring(angle):
        return plain(angle) + share * rim(angle, (20.0, 20.0), levels)

    profiles = [profile_of(f, 0.0, np.random.default_rng(0)) for f in (plain, mirroring)]
    root = np.sqrt(profiles[0].count) / 2
    model = Model(profiles[0], Blur(), root, angles(90), 5 * rough(90))
    start = np.array([*TRUTH, 0.9, np.log(0.3 / np.sqrt(2)), 0.0])
    still = followed(model, Found.first(model, start), 30)
    other = replace(model, profile=profiles[1])
    moved = followed(other, Found.first(other, still.parameters), 30)
    told = model.moved_by_rim(still.parameters, still.system)
    assert np.abs(told[[0, 2]]).min() > 0.02
    difference = (moved.parameters - still.parameters)[:5] / share
    np.testing.assert_allclose(difference, told[:5], atol=0.1 * np.abs(told[:5]).max())


def test_no_pixel_is_no_fit():
    profile = profile_of(oblique_metal, 2.0, np.random.default_rng(0))
    hidden = Profile(
        profile.grey,
        np.zeros_like(profile.count),
        profile.x_px,
        profile.edge,
        profile.half_px,
        profile.lever,
        profile.scale,
        2.0,
    )
    assert fit_glossy(hidden, 2.0, Blur(), 0.85) is None
