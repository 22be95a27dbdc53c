"""What stands in the report on paper: sections of text, tables and drawings, in order."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from markupsafe import Markup

from pivometer.calibration.advice import advice
from pivometer.calibration.result import Calibration
from pivometer.measurement import Measurement, RejectedPose, UsedPose
from pivometer.report import captions, setup_tables, tables
from pivometer.report.chart import pose_chart
from pivometer.report.coverage import coverage_pictures
from pivometer.report.edge_plots import edge_plot, profile_plot
from pivometer.report.embedding import Carried, Key, SimulatedTruth
from pivometer.report.overlays import photo_overlay
from pivometer.report.points import all_points_table
from pivometer.report.scene import scene, scene_picture
from pivometer.report.shaft_tables import shaft_table
from pivometer.report.signatures import SEALED, roles
from pivometer.report.structure_figures import direction_map, order_chart
from pivometer.report.structure_tables import component_table, pattern_table, structure_sentences
from pivometer.report.svg_style import standalone
from pivometer.report.tables import Table
from pivometer.report.target import deciding_poses, target_plot
from pivometer.report.thumbnails import Thumbnail
from pivometer.report.uncertainty_tables import (
    budget_sentences,
    budget_table,
    floor_table,
    monte_carlo_table,
)
from pivometer.report.verdict import verdict
from pivometer.shaft.across import EdgeProfiles

Block = dict[str, Any]


@dataclass(slots=True, eq=False)
class Paper:
    """The report on paper while it is put together.

    Parameters
    ----------
    measurement
        What is reported.
    thumbnails, profiles
        Pictures, and grey levels across the edges, by pose and camera.
    truth
        What is known of a simulated session.
    carried
        What the report carries.
    drawings, photos
        The drawings' SVG and the pictures' JPEG by name; filled as blocks are made.
    """

    measurement: Measurement
    thumbnails: Mapping[Key, Thumbnail]
    profiles: Mapping[Key, EdgeProfiles]
    truth: SimulatedTruth | None
    carried: Carried
    drawings: dict[str, str] = field(default_factory=dict)
    photos: dict[str, bytes] = field(default_factory=dict)

    def sections(self) -> list[dict[str, Any]]:
        """Return all sections that have something to say."""
        made = {
            "Verdict": self._verdict,
            "Result": self._result,
            "Beside the paper’s Table I": self._paper,
            "Target": self._target,
            "Every pose": self._poses,
            "Structure of the error": self._structure,
            "In space": self._space,
            "Pose by pose": self._gallery,
            "Rejected poses": self._rejected,
            "Calibration": self._calibration,
            "Uncertainty budget": self._budget,
            "Set-up": self._setup,
            "Provenance": self._provenance,
            "Signatures": self._signatures,
        }
        sections = [{"title": title, "blocks": [*blocks()]} for title, blocks in made.items()]
        return [section for section in sections if section["blocks"]]

    # --- Drawings ---

    def _drawing(self, drawing: Markup, *, style: str = "") -> str:
        name = f"drawing-{len(self.drawings)}"
        self.drawings[name] = standalone(drawing, style=style)
        return name

    def _figure(self, drawing: Markup, caption: str, *, width: int = 100) -> Block:
        return {
            "block": "figure",
            "file": self._drawing(drawing),
            "caption": caption,
            "alt": caption.partition(". ")[0],
            "width": width,
        }

    # --- Sections ---

    def _verdict(self) -> Iterator[Block]:
        told = verdict(self.measurement)
        yield {"block": "verdict", "usable": told.usable, "text": told.sentence}
        if told.decision:
            yield {
                "block": "verdict",
                "usable": not told.decision.startswith("✕"),
                "text": told.decision,
            }
        yield _text(told.rule)
        if self.measurement.decision is not None:
            yield {"block": "list", "items": [*self.measurement.decision.conditions]}
        yield _text(told.rejected)
        for one in self.measurement.findings:
            yield {
                "block": "finding",
                "refusal": one.severity == "refusal",
                "text": one.text,
                "next_step": one.next_step,
            }
        if not self.measurement.findings:
            yield _text("No warnings.")
        if self.truth is not None:
            yield _table(tables.truth_table(self.measurement, self.truth))

    def _result(self) -> Iterator[Block]:
        m = self.measurement
        shaft = shaft_table(m)
        for table in (tables.board_location_table(m), tables.location_table(m)):
            if table is not None:
                yield _table(table)
        yield _table(tables.miss_table(m))
        own = tables.own_error_table(m)
        if own is not None:
            yield _table(own)
        if shaft is not None:
            yield _table(shaft, "texts")
        yield _table(all_points_table(m))

    def _paper(self) -> Iterator[Block]:
        yield _table(tables.paper_table(self.measurement))

    def _numbers(self) -> list[int]:
        numbered = enumerate(self.measurement.poses, start=1)
        return [n for n, pose in numbered if isinstance(pose, UsedPose)]

    def _target(self) -> Iterator[Block]:
        drawing = target_plot(self.measurement, self._numbers())
        yield self._figure(drawing, captions.target(self.measurement), width=76)

    def _poses(self) -> Iterator[Block]:
        yield self._figure(pose_chart(self.measurement), captions.CHART)
        numbers = {pose.pose: n for n, pose in enumerate(self.measurement.poses, start=1)}
        yield _table(tables.pose_table(self.measurement, numbers))

    def _structure(self) -> Iterator[Block]:
        structure = self.measurement.structure
        if structure is None:
            return
        yield {"block": "list", "items": structure_sentences(structure)}
        yield _table(component_table(structure))
        if structure.patterns:
            yield _table(pattern_table(structure))
        yield self._figure(direction_map(structure), captions.MAP, width=66)
        yield self._figure(order_chart(structure), captions.ORDER)

    def _space(self) -> Iterator[Block]:
        shown = scene(self.measurement, self._numbers())
        far, near = (
            self._figure(scene_picture(shown, zoom, name), text, width=88)
            for zoom, name, text in (
                (1, "scene", captions.scene_far(self.measurement)),
                (shown.near_zoom, "scene-near", captions.scene_near(shown.near_zoom)),
            )
        )
        yield from (far, near)

    def _rejected(self) -> Iterator[Block]:
        if self.measurement.rejected:
            yield _table(tables.rejected_table(self.measurement), "texts")

    def _calibration(self) -> Iterator[Block]:
        m, calibration = self.measurement, self.measurement.calibration
        known = isinstance(calibration, Calibration)
        if isinstance(calibration, Calibration):
            yield _text(
                captions.advice_text(advice(calibration, at_mm=m.rcm.least_squares.point_mm))
            )
        yield _table(setup_tables.camera_table(m))
        yield _table(setup_tables.relative_pose_table(m))
        if not known or not isinstance(calibration, Calibration):
            return
        yield _table(setup_tables.length_table(calibration))
        drawn = [self._figure(one, text) for one, text in coverage_pictures(calibration)]
        yield {"block": "pair", "figures": drawn}
        yield _text(captions.views_text(calibration))
        views = setup_tables.view_table(calibration)
        if views.rows:
            yield _table(views, "texts")
        if calibration.notes:
            yield {"block": "list", "items": [*calibration.notes]}

    def _budget(self) -> Iterator[Block]:
        m = self.measurement
        budget, floor, drawn = budget_table(m), floor_table(m), monte_carlo_table(m)
        if budget is not None:
            yield _table(budget)
            yield {"block": "list", "items": budget_sentences(m)}
        if floor is not None:
            yield _table(floor, "texts")
        if drawn is not None:
            yield _table(drawn)

    def _setup(self) -> Iterator[Block]:
        yield _table(setup_tables.setup_table(self.measurement), "texts")
        if self.measurement.setup.notes:
            yield _text(f"Notes: {self.measurement.setup.notes}")

    def _provenance(self) -> Iterator[Block]:
        yield _table(setup_tables.provenance_table(self.measurement, self.carried.seal), "texts")
        yield _text(captions.CARRIED)
        yield _table(tables.input_table(self.measurement.inputs), "hashes")

    def _signatures(self) -> Iterator[Block]:
        named = [{"title": title, "name": name} for title, name in roles(self.measurement)]
        yield {"block": "signatures", "text": SEALED, "roles": named}

    def _gallery(self) -> Iterator[Block]:
        yield _text(f"{captions.PICTURES} {captions.GALLERY}")
        numbered = enumerate(self.measurement.poses, start=1)
        yield {"block": "cards", "cards": [self._card(pose, n) for n, pose in numbered]}

    # --- Poses ---

    def _card(self, pose: UsedPose | RejectedPose, number: int) -> Block:
        used, edges = isinstance(pose, UsedPose), tables.edge_table(pose)
        worst = pose.pose in deciding_poses(self.measurement)
        return {
            "number": number,
            "name": pose.pose,
            "badge": "▲ max" if worst else "" if used else "✕ rejected",
            "reason": "" if isinstance(pose, UsedPose) else pose.reason,
            "next_step": "" if isinstance(pose, UsedPose) else pose.next_step,
            "facts": tables.pose_facts(pose, self.measurement)
            if isinstance(pose, UsedPose)
            else (),
            "pictures": [*self._photos(pose)],
            "columns": edges.columns,
            "rows": edges.rows,
            "plots": [*self._plots(pose)],
            "warnings": [f"{one.camera}: {text}" for one in pose.edges for text in one.warnings],
        }

    def _photos(self, pose: UsedPose | RejectedPose) -> Iterator[Block]:
        for camera in self.measurement.calibration.rig.cameras:
            thumbnail = self.thumbnails.get((pose.pose, camera.name))
            if thumbnail is None:
                continue
            name = f"photo-{len(self.photos)}.jpg"
            self.photos[name] = thumbnail.jpeg
            pen = camera.width / 240
            style = (
                f".edge,.centerline,.cross{{fill:none;stroke-width:{pen:.2f}}}.edge{{stroke:#ff9d00}}"
                f".centerline{{stroke:#00c8ff;stroke-dasharray:{4 * pen:.1f} {3 * pen:.1f}}}"
                f".cross{{stroke:#ff4fd8;stroke-width:{1.5 * pen:.2f}}}"
            )
            overlay = photo_overlay(pose, camera, self.measurement)
            yield {
                "camera": camera.name,
                "file": name,
                "overlay": self._drawing(overlay, style=style),
                "alt": f"Pose {pose.pose}, camera {camera.name}",
            }

    def _plots(self, pose: UsedPose | RejectedPose) -> Iterator[Block]:
        for one in pose.edges:
            profiles = self.profiles.get((pose.pose, one.camera))
            if profiles is not None:
                yield self._plot(profile_plot(profiles, one.camera), f"{one.camera}, grey levels")
        for one in pose.edges:
            plot = edge_plot(one)
            if plot is not None:
                yield self._plot(plot, f"{one.camera}, edges")

    def _plot(self, drawing: Markup, alt: str) -> Block:
        return {"file": self._drawing(drawing), "alt": alt}


def _text(text: str) -> Block:
    return {"block": "text", "text": text}


def _table(table: Table, kind: str = "") -> Block:
    return {
        "block": "table",
        "kind": kind,
        "caption": table.caption,
        "columns": table.columns,
        "rows": table.rows,
        "note": table.note,
        "numeric": [kind == "" and _numeric(table.rows, n) for n in range(len(table.columns))],
    }


def _numeric(rows: Sequence[Sequence[str]], column: int) -> bool:
    """Tell whether a column holds numbers, to be set flush right."""
    cells = [row[column] for row in rows]
    return column > 0 and all(cell[:1] in "-–(<✓" or cell[:1].isdigit() for cell in cells)
