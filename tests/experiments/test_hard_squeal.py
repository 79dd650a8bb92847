"""Branches and maps as they are shown: pictures and tables agree with the model asked point by point."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from squeal_rig.errors import DiskError, ModelError, ParameterError
from squeal_rig.model import RigParameters, eigenvalues, simulate, smallest_hit, squeal_cycle, zone
from squeal_rig.model.core.law import friction_coefficient
from squeal_rig.model.cycles.tracing import FLUTTER
from squeal_rig.model.cycles.zone_map import BISTABLE, NAMES, QUIET, SQUEAL
from squeal_rig.report.paper_style import picture
from squeal_rig.studies.hard_squeal.branches import branch_diagram
from squeal_rig.studies.hard_squeal.chart import zone_chart
from squeal_rig.studies.hard_squeal.figures import _CLEAR, _label_places, branch_figure, zone_figure
from squeal_rig.studies.hard_squeal.pages import period_table, run_cycles, run_map, what_figure_9_does_not_show

RIG = RigParameters.preset("yavuz_sen_2023").replace(damping_x=1000.0, damping_y=1000.0)
# All three zones within the paper's preloads and speeds.
THREE_ZONES = RIG.replace(damping_x=4000.0, damping_y=4000.0, mu0=-0.05, mu_speed=0.05)
PNG = b"\x89PNG"


@pytest.fixture(scope="module")
def diagram():
    return branch_diagram(RIG, "mu0")


@pytest.fixture(scope="module")
def chart():
    return zone_chart(THREE_ZONES, (20.0, 300.0), (0.5, 4.0), points=40)


def borders_of(diagram):
    """Where the zone changes along the field: (value, zone below, zone above)."""
    changes = np.flatnonzero(np.diff(diagram.zones))
    return [
        (0.5 * (diagram.values[i] + diagram.values[i + 1]), int(diagram.zones[i]), int(diagram.zones[i + 1]))
        for i in changes
    ]


def unstable(p):
    return bool(max(eigenvalues(p).real) > 0.0)


def test_the_zones_behind_a_branch_change_at_its_fold_and_at_the_flutter_threshold(diagram):
    # docs: fold 0.0878 and threshold 0.39476 in mu at c = 1000 N s/m; the grid is 0.06 % of mu wide.
    (fold, *below), (flutter, *above) = borders_of(diagram)
    shift = friction_coefficient(RIG) - RIG.mu0
    assert (below, above) == ([QUIET, BISTABLE], [BISTABLE, SQUEAL])
    assert fold + shift == pytest.approx(0.0878, abs=5e-4)
    assert flutter + shift == pytest.approx(0.39476, abs=5e-4)
    assert diagram.zone.name == "bistable"


def test_both_cycles_at_the_rigs_own_value_are_those_that_the_model_finds(diagram):
    kinds = {diagram.kind_of(cycle): cycle for cycle in diagram.cycles}
    assert set(kinds) == {"squeal", "separatrix"}
    assert kinds["squeal"].frequency == pytest.approx(squeal_cycle(RIG).frequency, rel=1e-9)
    assert kinds["separatrix"].frequency == pytest.approx(zone(RIG).separatrix.frequency, rel=1e-9)


def test_the_force_over_a_period_is_nothing_as_long_as_the_pad_is_off_the_belt(diagram):
    table = period_table(diagram)
    for cycle in diagram.cycles:
        force = np.array([row[-1] for row in table.rows if row[0] == diagram.kind_of(cycle)])
        assert force.min() == 0.0
        # Of 256 samples a period one may fall either way at each of two events.
        assert np.mean(force == 0.0) == pytest.approx(cycle.off_belt_share, abs=2.5 / 256)
        run = simulate(RIG, cycle.period, 256.0 / cycle.period, cycle.state)
        # The run's samples lie on those of the cycle; 1e-6 of the largest force is far above both engines' errors.
        np.testing.assert_allclose(force, run.normal_force[: len(force)], atol=1e-6 * force.max())


def test_a_quiet_rigs_branch_is_begun_between_both_borders():
    diagram = branch_diagram(RIG.replace(mu0=-0.05), "mu0")
    assert diagram.zone.name == "quiet"
    assert diagram.values[0] < -0.05 < diagram.begun_at
    assert {diagram.kind_of(cycle) for cycle in diagram.cycles} == {"squeal", "separatrix"}
    with pytest.raises(ModelError, match="no squeal cycle to follow in preload: the motion dies out"):
        branch_diagram(RIG.replace(mu0=-0.05), "preload")


def test_over_the_preload_the_separatrix_is_followed_too_and_ends_where_an_eigenvalue_crosses():
    diagram = branch_diagram(RIG, "preload", (20.0, 100.0))
    squeal, separatrix = diagram.branches
    assert squeal.points["stable"].all()
    ends = [end for end in separatrix.ends if end.how == FLUTTER]
    assert len(ends) == 1
    threshold = ends[0].parameter
    assert [unstable(RIG.replace(preload=share * threshold)) for share in (0.999, 1.001)] == [False, True]
    assert [codes for _, *codes in borders_of(diagram)] == [[BISTABLE, SQUEAL]]


def test_above_the_flutter_threshold_no_cycle_is_called_a_separatrix():
    diagram = branch_diagram(RIG.replace(preload=300.0), "mu0")
    assert diagram.zone.name == "squeal"
    assert [diagram.kind_of(cycle) for cycle in diagram.cycles] == ["squeal"]


def test_the_map_has_the_zone_and_the_hit_that_the_model_finds_at_each_point(chart):
    assert all(chart.share(code) > 0.03 for code in (QUIET, BISTABLE, SQUEAL))
    random = np.random.default_rng(11)
    for i, j in zip(random.integers(0, 40, 12).tolist(), random.integers(0, 40, 12).tolist(), strict=True):
        p = THREE_ZONES.replace(preload=float(chart.preloads[j]), belt_speed=float(chart.speeds[i]))
        assert NAMES[int(chart.map.zone[i, j])] == zone(p).name
        if chart.map.zone[i, j] == BISTABLE:
            hit = smallest_hit(p, beyond=1.0)
            assert chart.map.smallest_hit[i, j] == pytest.approx(hit.impulse, rel=2.0 * chart.map.hit_error + 0.02)


def test_a_law_that_gives_negative_friction_somewhere_is_refused():
    with pytest.raises(ParameterError, match=r"the friction law gives mu = -0\.3\d+ at preload = 400 N and belt_speed"):
        zone_chart(RIG.replace(mu0=-0.05), (5.0, 400.0), (0.5, 6.0), points=5)
    with pytest.raises(ParameterError, match=r"the friction law gives mu = -0\.4"):
        branch_diagram(RIG.replace(mu0=-0.5), "mu0")


def test_labels_keep_clear_of_other_lines_and_of_the_edges(chart):
    at = np.linspace(0.0, 1.0, 101)

    def line(offset):
        """A line across the picture, in its own units."""
        share = np.column_stack([at, 0.5 * at + offset])
        return np.array([20.0, 0.5]) + share * np.array([280.0, 3.5])

    far, near, beside = line(0.1), line(0.4), line(0.4 + 0.5 * _CLEAR)
    assert len(_label_places([far, near], [], chart)) == 2
    ((x, y),) = _label_places([far, near, beside], [], chart)
    assert any(np.allclose((x, y), point) for point in far)
    assert _label_places([near], [beside], chart) == []


def read(path):
    with path.open(newline="", encoding="utf-8") as stream:
        head, *rows = list(csv.reader(stream))
    return head, rows


def test_a_page_of_cycles_stands_with_its_pictures_and_tables(tmp_path, diagram):
    run_cycles(RIG, "mu0", None, tmp_path / "new" / "folder", False, Console(quiet=True))
    folder = tmp_path / "new" / "folder"
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "index.html", "branch.png", "multipliers.png", "cycles.png",
        "branch.csv", "specials.csv", "cycles.csv", "cycles_summary.csv",
    }  # fmt: skip
    assert all((folder / name).read_bytes().startswith(PNG) for name in names if name.endswith(".png"))
    head, rows = read(folder / "branch.csv")
    assert head[:6] == ["branch", "mu0 [-]", "mu [-]", "frequency [Hz]", "peak_x [m]", "peak_y [m]"]
    points = diagram.branches[0].points
    np.testing.assert_array_equal([float(row[3]) for row in rows], points["frequency"])
    head, rows = read(folder / "specials.csv")
    assert [row[0] for row in rows] == ["end: flutter threshold", "fold", "end: bound"]
    assert float(rows[1][2]) == pytest.approx(0.0878, abs=5e-5)
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 3
    assert "Zone: bistable" in page
    with pytest.raises(DiskError, match="is not empty; --force"):
        run_cycles(RIG, "mu0", None, folder, False, Console(quiet=True))


def test_a_page_of_zones_stands_with_its_picture_and_every_point(tmp_path):
    run_map(RIG, (10.0, 300.0), (1.0, 4.0), tmp_path, False, Console(quiet=True))
    assert {path.name for path in tmp_path.iterdir()} == {"index.html", "zones.png", "zones.csv"}
    head, rows = read(tmp_path / "zones.csv")
    assert head == ["F [N]", "V [m/s]", "mu [-]", "fold_mu [-]", "flutter_mu [-]", "smallest_hit [N s]", "zone"]
    assert len(rows) == 200 * 200
    mu, flutter = (np.array([float(row[i]) for row in rows]) for i in (2, 4))
    zones = np.array([row[-1] for row in rows])
    # The paper's preloads and speeds: nothing is quiet whatever happens, and the rest is told by the threshold.
    np.testing.assert_array_equal(zones, np.where(mu >= flutter, "squeal", "bistable"))
    assert "quiet 0.0%" in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_the_reproduction_has_the_section_and_a_sentence_where_there_is_nothing_to_show(chart, diagram):
    section = what_figure_9_does_not_show(diagram, chart)
    assert section.title == "What Fig. 9 does not show"
    assert [shown.name for shown in section.pictures] == ["fig_09_zones", "fig_09_branch", "fig_09_cycles"]
    empty = what_figure_9_does_not_show(ModelError("no cycle"), chart)
    assert (empty.text, empty.pictures) == (["no cycle."], [])


def test_pictures_are_drawn_without_a_map_of_hits_and_without_borders(chart):
    still = zone_chart(
        RigParameters.preset("yavuz_sen_2023_as_printed").replace(damping_x=20.0, damping_y=20.0), points=4
    )
    assert still.share(QUIET) == 1.0
    assert math.isnan(still.map.flutter_mu[0, 0])
    assert zone_figure(still).png.startswith(PNG)
    assert len(branch_figure(branch_diagram(RIG, "damping_y", (200.0, 1500.0))).png) > 20_000
    assert picture("empty", "", lambda axes: None).png.startswith(PNG)


def test_the_page_for_users_says_what_its_python_lines_give():
    text = (Path(__file__).parents[2] / "docs" / "hard_squeal.md").read_text(encoding="utf-8")
    lines = text.split("## From Python")[1].split("## Limits")[0].splitlines()
    code = "\n".join(line[4:] for line in lines if line.startswith("    "))
    names: dict = {}
    exec(code, names)
    p = names["p"]
    assert zone(p).name == "bistable"
    assert squeal_cycle(p).frequency == pytest.approx(994.70, abs=0.005)
    assert len(names["branch"].folds) == 1
