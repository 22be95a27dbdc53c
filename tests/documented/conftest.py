"""The pages of README and docs/, each followed once, in a folder of its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import pytest
from tests.documented.given import Given, Once
from tests.documented.pages import all_pages, page_name, steps_of
from tests.documented.running import PageRun

from pivometer import pipeline
from pivometer.pipeline import measuring, simulating


@pytest.fixture(scope="package")
def followed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mapping[str, PageRun]]:
    """Return every page by its name, none of it followed yet."""
    store = tmp_path_factory.mktemp("given")
    once = Once(store / "simulated")
    with pytest.MonkeyPatch.context() as patch:
        for module, name, done_once in (
            (simulating, "simulate", once.simulate),
            (measuring, "calibrate", once.calibrate),
            (measuring, "see_shafts", once.see_shafts),
        ):
            patch.setattr(module, name, done_once(getattr(module, name)))
            patch.setattr(pipeline, name, getattr(module, name))
        patch.setattr(pipeline, "plan", once.plan(pipeline.plan))
        patch.setenv("COLUMNS", "100")
        given = Given(store)
        yield {
            page_name(path): PageRun(steps_of(path), tmp_path_factory.mktemp("page"), given)
            for path in all_pages()
        }
