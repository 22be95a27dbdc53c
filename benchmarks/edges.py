"""Both edges of a shaft: accuracy beside the Cramér–Rao bound and public methods, and time.

Run with ``OMP_NUM_THREADS=1 python -m benchmarks.edges [--scenes N] [--only ROW] [--seed S]``.
Offsets are compared at the middle of the visible edge, in undistorted px, and printed in 0.001 px.
Every method is told the edges to 2 px and sees the same images in the same run.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.shaft_edges.peers import PEERS, Lines
from benchmarks.shaft_edges.scenes import (
    CELLS,
    Look,
    Scene,
    bound_px,
    composited,
    exposed,
    make,
    middle_of,
    supersampled_difference,
)
from pivometer.errors import ShaftNotFoundError
from pivometer.shaft.edges import ShaftEdges, fit_edges
from pivometer.shaft.seed import ShaftSeed

Floats = NDArray[Any]
GROSS_PX = 1.5
"""An edge that is further off counts as not found, and not in the rms."""


def flat(level: float) -> Callable[[Floats], Floats]:
    """Return the shading of a flat bright strip."""
    return lambda xi: np.full_like(xi, level)


def clean(rng: np.random.Generator) -> Scene:
    """Render contrast 160, blur 0.8, noise 2."""
    return make(rng, Look(flat(180.0), 20.0, 0.8, 2.0))


def large(rng: np.random.Generator) -> Scene:
    """Render the same at 1920 × 1200."""
    return make(rng, Look(flat(180.0), 20.0, 0.8, 2.0), size=(1920, 1200))


def faint(rng: np.random.Generator) -> Scene:
    """Render contrast 40, blur 1.5, noise 5."""
    return make(rng, Look(flat(100.0), 60.0, 1.5, 5.0))


def near_axis(rng: np.random.Generator) -> Scene:
    """Render within 0.4° of a pixel axis; little noise, so that sampling shows."""
    return make(rng, Look(flat(180.0), 20.0, 0.8, 0.8), angle_deg=90 - rng.uniform(0, 0.4), taper=0)


def occluded(rng: np.random.Generator) -> Scene:
    """Hide a fifth of the length."""
    first = rng.uniform(0.1, 0.5)
    return make(rng, Look(flat(180.0), 20.0, 0.8, 2.0, hidden=(first, first + 0.15)))


def thin(rng: np.random.Generator) -> Scene:
    """Render a shaft 5 to 10 px wide."""
    width = rng.uniform(5, 10)
    return make(rng, Look(flat(180.0), 20.0, 0.8, 2.0), width_px=width, taper=0.0005)


def lambert(rng: np.random.Generator) -> Scene:
    """Render a round matt shaft lit from around the camera."""
    ambient, side = rng.uniform(60, 90), rng.uniform(-15, 15)
    return make(
        rng,
        Look(lambda xi: ambient + side * xi + 110 * np.sqrt(1 - xi * xi), 20.0, 0.8, 2.0),
    )


def nearly_lambert(rng: np.random.Generator) -> Scene:
    """Render the matt shaft with a third of a grey level that goes twice around it."""
    ambient, side, at = rng.uniform(60, 90), rng.uniform(-15, 15), rng.uniform(0, 2 * np.pi)

    def shading(xi: Floats) -> Floats:
        other = 0.3 * np.cos(2 * np.arcsin(xi) - at)
        return np.asarray(ambient + side * xi + 110 * np.sqrt(1 - xi * xi) + other)

    return make(rng, Look(shading, 20.0, 0.8, 2.0))


FILTERS = (((1.0, 1.0), (1.0, 0.9)), ((1.0, 0.9), (1.0, 0.7)))
"""What filters of two rows and two columns pass of the dark and of the bright thing."""


def filtered(rng: np.random.Generator) -> Scene:
    """Render the matt shaft, yellowish before grey, behind a mosaic of colour filters."""
    scene = lambert(rng)
    image, part = np.empty(scene.clean.shape), (scene.clean - 20.0) / 160.0
    for row, filters in enumerate(FILTERS):
        for column, (dark, bright) in enumerate(filters):
            at = slice(row, None, 2), slice(column, None, 2)
            image[at] = 20.0 * dark + (180.0 * bright - 20.0 * dark) * part[at]
    return replace(scene, image=exposed(image, scene.look.noise, rng))


def metal(rng: np.random.Generator) -> Scene:
    """Render brushed metal lit from one side: a broad highlight between axis and edge."""
    towards, shine = rng.uniform(35, 65), rng.uniform(4, 16)
    side = 1 if rng.random() < 0.5 else -1

    def shading(xi: Floats) -> Floats:
        away = np.arcsin(side * xi) - np.radians(towards)
        lit = np.clip(np.cos(away), 0, None)
        return np.asarray(70 + 60 * lit + 90 * lit**shine)

    return make(rng, Look(shading, 20.0, 0.8, 2.0))


def stripe(rng: np.random.Generator) -> Scene:
    """Render a narrow highlight 2 to 5 px inside one edge."""
    width = rng.uniform(24, 60)
    inside, spread = rng.uniform(2, 5), rng.uniform(0.6, 1.5)
    side = 1 if rng.random() < 0.5 else -1

    def shading(xi: Floats) -> Floats:
        return 120.0 + 110.0 * np.exp(-0.5 * (((1 - side * xi) * width / 2 - inside) / spread) ** 2)

    return make(rng, Look(shading, 20.0, 0.8, 2.0), width_px=width)


def two_lights(rng: np.random.Generator) -> Scene:
    """Render a shaft with the highlights of two lights."""
    lights = [
        (np.radians(rng.uniform(-70, 70)), rng.uniform(4, 40), rng.uniform(18, 54))
        for _ in range(2)
    ]

    def shading(xi: Floats) -> Floats:
        lit = [(np.clip(np.cos(np.arcsin(xi) - a), 0, None), n, s) for a, n, s in lights]
        return np.asarray(50 + sum(40 * c + s * c**n for c, n, s in lit))

    return make(rng, Look(shading, 20.0, 0.8, 2.0))


def window_image(rng: np.random.Generator) -> Scene:
    """Render a matt shaft with the sharp image of a window."""
    at, half, shine = rng.uniform(-75, 75), rng.uniform(3, 15), rng.uniform(30, 110)

    def shading(xi: Floats) -> Floats:
        away = np.abs(np.degrees(np.arcsin(xi)) - at)
        window = np.clip((half - away) / 3 + 0.5, 0, 1)
        return np.asarray(60 + 60 * np.sqrt(1 - xi * xi) + shine * window)

    return make(rng, Look(shading, 20.0, 0.8, 2.0))


def bright_rim(rng: np.random.Generator) -> Scene:
    """Render dark plastic before a bright wall that its rim reflects as Schlick says."""
    rim, towards, shine = rng.uniform(40, 120), np.radians(rng.uniform(20, 60)), rng.uniform(10, 60)

    def shading(xi: Floats) -> Floats:
        lit = np.clip(np.cos(np.arcsin(xi) - towards), 0, None)
        return np.asarray(30 + 50 * lit + 60 * lit**shine + rim * (1 - np.sqrt(1 - xi * xi)) ** 5)

    return make(rng, Look(shading, 200.0, 0.8, 2.0))


def clutter(rng: np.random.Generator) -> Scene:
    """Render sharp texture behind the shaft, composited in cells; an empty frame is given."""
    texture = np.full((480 * CELLS, 640 * CELLS), 80, dtype=np.float32)
    for _ in range(1500):
        place = tuple(int(v) for v in rng.uniform(0, [640 * CELLS, 480 * CELLS]))
        axes = tuple(int(v) for v in rng.uniform(3, 20, 2) * CELLS)
        grey = float(rng.uniform(30, 130))
        cv2.ellipse(texture, place, axes, float(rng.uniform(0, 180)), 0, 360, grey, -1)
    return make(rng, Look(flat(190.0), 80.0, 0.8, 2.0, texture=texture))


def colourful(rng: np.random.Generator) -> Scene:
    """Render texture of many colours behind a mosaic of colour filters; an empty frame is given."""
    scene = clutter(rng)
    assert scene.look.texture is not None
    texture = scene.look.texture
    image, empty = np.empty((2, *scene.clean.shape))
    for place, tint in enumerate((0.1, 0.0, 0.0, -0.1)):
        tinted = (texture * (1 + tint * np.sin(texture / 12))).astype(np.float32)
        at = slice(place // 2, None, 2), slice(place % 2, None, 2)
        for picture, shaft in ((image, True), (empty, False)):
            picture[at] = composited(scene.geometry, tinted, scene.look, shaft=shaft)[at]
    shown, behind = (exposed(picture, scene.look.noise, rng) for picture in (image, empty))
    return replace(scene, image=shown, background=behind)


LENS = (-0.28, 0.0)


def distorted(rng: np.random.Generator) -> Scene:
    """Render through a lens with k₁ = −0.28."""
    return make(rng, Look(flat(180.0), 20.0, 0.8, 2.0), lens=LENS)


@dataclass(frozen=True)
class Row:
    """One row of the table and what it must reach."""

    name: str
    scene: Callable[[np.random.Generator], Scene]
    centre: bool  # the centre of both edges counts, not each edge
    target: str
    share: float = 1.0  # of the number of scenes


ROWS = (
    Row("clean", clean, False, "1.05× bias .1×"),
    Row("clean, 1920 × 1200", large, False, "1.05× bias .1×", 0.15),
    Row("contrast 40, blur 1.5, noise 5", faint, False, "1.05× bias .1×"),
    Row("within 0.4° of an axis", near_axis, False, "1.3×"),
    Row("20 % occluded", occluded, False, "1.3×"),
    Row("5–10 px wide", thin, False, "1.1×"),
    Row("k₁ = −0.28", distorted, False, "1.1× of clean"),
    Row("Lambert, each edge", lambert, False, "5"),
    Row("nearly Lambert, each edge", nearly_lambert, False, "–", 0.6),
    Row("Lambert behind filters, each edge", filtered, False, "1.5× of Lambert"),
    Row("oblique metal, centre", metal, True, "15"),
    Row("highlight stripe, centre", stripe, True, "100"),
    Row("two lights, centre", two_lights, True, "–", 0.6),
    Row("image of a window, centre", window_image, True, "–", 0.6),
    Row("bright rim, centre", bright_rim, True, "–", 0.6),
    Row("bright rim, each edge", bright_rim, False, "–", 0.6),
    Row("textured clutter", clutter, False, "8", 0.25),
    Row("many colours behind filters", colourful, False, "8", 0.1),
)


def fit(scene: Scene) -> ShaftEdges | None:
    """Return Pivometer's edges."""
    try:
        seed = ShaftSeed(scene.seed_px)
        return fit_edges(scene.image, scene.camera, seed, background=scene.background)
    except ShaftNotFoundError:
        return None


def errors(scene: Scene, lines: Lines) -> Floats:
    """Return how far outward of the truth both lines are at the visible middle, px; NaN: none."""
    off = np.full(2, np.nan)
    for edge, line in enumerate(lines):
        if line is not None:
            middle, normal = middle_of(scene, edge), scene.geometry.normals[edge]
            across = np.array([-line[1, 1], line[1, 0]])
            off[edge] = (line[0] - middle) @ across / (normal @ across)
    return np.where(np.abs(off) < GROSS_PX, off, np.nan)


def own_lines(scene: Scene, edges: ShaftEdges | None) -> Lines:
    """Return Pivometer's edges in the peers' form."""
    if edges is None:
        return [None, None]
    ends = scene.camera.undistorted_pixels(edges.points_px[:, [0, -1]])
    return [np.array([pair[0], pair[1] - pair[0]]) for pair in ends]


def stated(scene: Scene, edges: ShaftEdges | None) -> Floats:
    """Return the stated sigma of both edges at the visible middle, px, and of the centre there."""
    if edges is None:
        return np.full(3, np.nan)
    camera = scene.camera
    rows = np.zeros((2, 6))
    for edge in range(2):
        ray = (middle_of(scene, edge) - camera.principal_point_px) / camera.focal_px
        rows[edge, 3 * edge : 3 * edge + 3] = np.append(ray, 1.0)
        rows[edge] *= camera.focal_px[0] / np.linalg.norm(edges.normals[edge][:2])
    rows = np.vstack([rows, (rows[0] - rows[1]) / 2])
    sigma: Floats = np.sqrt(np.einsum("ij,jk,ik->i", rows, edges.normals_covariance, rows))
    return sigma


def rms(values: Floats) -> float:
    """Return the root mean square of what is not NaN."""
    return float(np.sqrt(np.nanmean(np.square(values)))) if np.isfinite(values).any() else np.nan


def counted(off: Floats, row: Row) -> Floats:
    """Return the errors that a row counts, from both edges' of shape (n, 2)."""
    return (off[:, 0] - off[:, 1]) / 2 if row.centre else off.ravel()


def measure(row: Row, scenes: int, seed: int) -> str:
    """Return one line of the table."""
    rng = np.random.default_rng(seed)
    off: dict[str, list[Floats]] = {name: [] for name in ("Pivometer", *PEERS)}
    scores, bounds = [], []
    times: dict[str, list[float]] = {name: [] for name in ("Pivometer", "PNG")}
    difference = 0.0
    for index in range(max(4, int(scenes * row.share))):
        scene = row.scene(rng)
        start = time.process_time()
        edges = fit(scene)
        times["Pivometer"].append(time.process_time() - start)
        coded = cv2.imencode(".png", scene.image)[1]
        start = time.process_time()
        cv2.imdecode(coded, cv2.IMREAD_UNCHANGED)
        times["PNG"].append(time.process_time() - start)
        off["Pivometer"].append(errors(scene, own_lines(scene, edges)))
        sigma = stated(scene, edges)
        own = off["Pivometer"][-1]
        scores.append((own[0] - own[1]) / 2 / sigma[2:] if row.centre else own / sigma[:2])
        if index < scenes // 2:
            for name, peer in PEERS.items():
                off[name].append(errors(scene, peer(scene)))
        if index < 4:
            bounds.append(bound_px(scene)[row.centre])
            if scene.look.texture is None and not scene.look.hidden[1]:
                difference = max(difference, supersampled_difference(scene))
    found = {name: counted(np.array(values), row) for name, values in off.items()}
    bound = rms(np.array(bounds))
    own = found["Pivometer"]
    inside = np.concatenate(scores)
    covered = 100 * np.mean(np.abs(inside[np.isfinite(inside)]) < 1.96)
    ms, png = (1e3 * np.median(times[name]) for name in ("Pivometer", "PNG"))
    peers = "".join(f"{_figure(found[name]):>9}" for name in PEERS)
    return (
        f"{row.name:32}{1e3 * bound:7.2f}{_figure(own):>10}{rms(own) / bound:7.2f}×"
        f"{1e3 * np.nanmean(own):8.2f}{covered:6.0f} %{ms / png:7.1f}×{ms:7.1f}"
        f"  {peers}   {row.target:14} {difference:5.2f}"
    )


def _figure(values: Floats) -> str:
    """Return an rms in 0.001 px, with the share not found where there is any."""
    lost = np.mean(~np.isfinite(values))
    return f"{1e3 * rms(values):.4g}" + (f" ({100 * lost:.0f}%)" if lost else "")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=100, help="scenes a row")
    parser.add_argument("--only", default="", help="rows whose name holds this")
    parser.add_argument("--seed", type=int, default=20, help="of the scenes")
    options = parser.parse_args()
    print("offset at the middle, rms in 0.001 px (share not found), and the centre where named")
    print(
        f"{'scene':32}{'bound':>7}{'Pivometer':>10}{'/bound':>8}{'bias':>8}{'95 %':>8}{'/PNG':>8}"
        f"{'ms':>7}  " + "".join(f"{name:>9}" for name in PEERS) + "   must reach     render"
    )
    for row in ROWS:
        if options.only in row.name:
            print(measure(row, options.scenes, options.seed), flush=True)


if __name__ == "__main__":
    main()
