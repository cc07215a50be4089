"""The campaign's report: versions, passes with links, repeats, and a sentence where a part is absent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import report_samples as samples
from smts_validate.pipeline import report_campaign
from smts_validate.pipeline.campaign import summarise_campaign
from smts_validate.pipeline.remake import Exports, remake
from smts_validate.pipeline.report_blocks import Missing, Section, charts_of, tables_of
from smts_validate.pipeline.report_campaign_parts import CampaignView, parts_of


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = samples.campaign_folder(tmp_path_factory.mktemp("campaign") / "out")
    report_campaign.write_campaign_report(folder)
    return folder


@pytest.fixture(scope="module")
def view(out: Path) -> CampaignView:
    return report_campaign.read_campaign(out)


@pytest.fixture(scope="module")
def parts(view: CampaignView) -> dict[str, Section]:
    return {part.key: part for part in parts_of(view)}


def _cells(section: Section) -> list[tuple[str, ...]]:
    return [row for table in tables_of((section,)) for row in table.rows]


def test_every_pass_is_a_line_that_links_to_its_own_report(parts: dict[str, Section]) -> None:
    (table,) = tables_of((parts["passes"],))
    assert [row[0] for row in table.rows] == list(samples.RUNS)
    assert table.links == tuple(f"passes/{run}/report.html" for run in samples.RUNS)


def test_repeats_of_a_cell_are_drawn_over_one_another(parts: dict[str, Section]) -> None:
    charts = charts_of((parts["repeats"],))
    assert [[c.name for c in chart.panels[0].curves] for chart in charts] == [
        ["a-east-1", "a-east-2"],
        ["a-west-1"],
    ]


def test_what_is_left_out_and_what_failed_are_listed_with_reasons(parts: dict[str, Section]) -> None:
    assert set(_cells(parts["left-out"])) == {
        ("a-west-2", "left out", "flat <b>tyre</b>"),
        ("a-east-9", "failed", "gps.nmea: no position in it"),
    }


def test_page_is_escaped_and_names_the_verdicts_scope(out: Path) -> None:
    html = (out / "report.html").read_text(encoding="utf-8")
    assert "<i>trials" not in html
    assert "<b>tyre" not in html
    assert "scope: campaign" in html
    assert 'href="passes/a-east-1/report.html"' in html
    assert len(html.encode()) < 1_000_000


def test_parameters_that_never_changed_are_said_to_have_no_effect_to_tell(parts: dict[str, Section]) -> None:
    words = " ".join(
        block.text
        for block in parts["effects"].blocks
        if isinstance(block, Missing) or hasattr(block, "text")
    )
    assert "Never changed" in words


def test_empty_campaign_says_so_in_every_part() -> None:
    document: dict[str, Any] = {**summarise_campaign([]).document}
    for part in parts_of(CampaignView(document, {}, ())):
        assert part.blocks
        assert not charts_of((part,))


@pytest.mark.slow
def test_report_comes_again_with_exports(out: Path) -> None:
    before = (out / "report.pdf").read_bytes()
    assert remake(out, Exports(tables=("csv", "tex"))) == out / "report.html"
    assert (out / "report.pdf").read_bytes() == before
    passes = (out / "tables" / "passes.csv").read_text(encoding="utf-8").splitlines()
    assert len(passes) == 1 + len(samples.RUNS)
    assert (out / "passes" / "a-east-1" / "tables" / "companions.tex").is_file()
