"""The paper's results: what the rig reproduces, and what it does not, each as a fact on computed data."""

import math

import numpy as np
import pytest

from squeal_rig.estimation.harmonics import superharmonics
from squeal_rig.estimation.spectra import amplitude_spectrum
from squeal_rig.model import RigParameters
from squeal_rig.report.page import DataTable, Section, write_page
from squeal_rig.studies.reproduction import linear, nonlinear, statements
from squeal_rig.studies.reproduction.friction_law import measure_friction
from squeal_rig.studies.reproduction.paper import paper_numbers
from squeal_rig.studies.reproduction.run import DAMPING
from squeal_rig.studies.reproduction.statements import AGREES, DIFFERS

PAPER = paper_numbers()
PRESET = RigParameters.preset("yavuz_sen_2023")
DAMPED = PRESET.replace(damping_x=DAMPING, damping_y=DAMPING)
PRELOADS = np.linspace(10.0, 300.0, 30)
SPEEDS = np.linspace(1.0, 4.0, 7)


@pytest.fixture(scope="module")
def critical():
    return linear.critical_map(PRESET, PRELOADS, SPEEDS)


@pytest.fixture(scope="module")
def table():
    return nonlinear.table_rows(DAMPED, PAPER, duration=3.0)


def test_all_eight_thresholds_are_roots_within_eight_percent():
    rows = linear.threshold_rows(PRESET, PAPER)
    errors = [abs(row.error) for row in rows]
    assert len(rows) == 8
    assert all(row.confirmed for row in rows)
    assert max(errors) <= 0.08
    assert np.mean(errors) <= 0.042


def test_the_law_is_recovered_through_instruments_and_estimator():
    model = measure_friction(DAMPED).model
    # Eq. (2.1) holds to first order in r/L, 1e-4 here.
    assert model.coefficients["mu0"] == pytest.approx(PRESET.mu0, rel=1e-3)
    assert model.coefficients["mu_speed_preload"] == pytest.approx(PRESET.mu_speed_preload, rel=1e-3)
    assert model.rms_residual < 1e-6


def test_statement_1_mode_coupling_triggers_the_instability():
    assert statements.mode_coupling(linear.eigenvalue_loci(PRESET, points=81)).verdict == AGREES


def test_statement_2_preload_lowers_the_critical_stiffness(critical):
    assert statements.preload_lowers(PRELOADS, SPEEDS, critical).verdict == AGREES


def test_statement_3_belt_speed_raises_it_within_the_papers_preloads(critical):
    statement = statements.speed_raises(PRELOADS, SPEEDS, critical)
    assert statement.verdict == AGREES
    assert "below" in statement.evidence  # below 18 N the friction law rises with speed


def test_statement_4_frequencies_are_not_similar_and_the_evidence_says_how_far(table):
    assert statements.frequencies_similar(table).verdict == DIFFERS
    assert all(row.f_nonlinear < row.f_linear for row in table)  # the paper's nonlinear frequency is above


def test_statement_5_superharmonics_appear_where_unstable():
    assert statements.superharmonics_when_unstable(nonlinear.spectrum_cases(DAMPED, PAPER)).verdict == AGREES


def test_statement_6_separation_rises_with_stiffness_but_not_from_zero(table):
    assert statements.separation_at_high_stiffness(table).verdict == DIFFERS
    assert table[0].contact_loss_share > 0.4
    assert table[-1].contact_loss_share > table[0].contact_loss_share


def test_statement_7_deviation_grows_with_separation(table):
    assert statements.deviation_with_separation(table).verdict == AGREES


@pytest.mark.parametrize("start", [nonlinear.SMALL_START, nonlinear.IMPACT_START])
@pytest.mark.parametrize("jump", PAPER.jumps, ids=lambda jump: f"{jump.pad_stiffness:.0e}-{jump.belt_speed:g}")
def test_statement_8_peaks_jump_at_the_threshold_and_below_it_after_an_impact(jump, start):
    p = DAMPED.replace(pad_stiffness=jump.pad_stiffness, belt_speed=jump.belt_speed)
    threshold = linear.threshold_preload(p, 2000.0)
    assert threshold is not None
    around = np.array([0.5, 1.05]) * threshold
    curve = nonlinear.peak_curve(p, around, start, jump.value, 2000.0)
    assert curve.jump is not None
    if start == nonlinear.SMALL_START:
        assert curve.jump == pytest.approx(threshold, rel=0.05)
    else:
        assert curve.jump <= threshold * 1.05  # subcritical onset: a hit needs less preload


def test_there_is_no_jump_where_no_preload_is_unstable():
    p = DAMPED.replace(pad_stiffness=2e7, belt_speed=4.0)
    assert linear.threshold_preload(p, 1000.0) is None
    curve = nonlinear.peak_curve(p, np.array([500.0, 1000.0]), nonlinear.SMALL_START, None, 1000.0)
    assert curve.jump is None


def test_superharmonics_are_found_where_they_are_and_nowhere_else():
    t = np.arange(51200) / 51200.0
    noise = 1e-12 * np.random.default_rng(3).normal(size=t.size)
    plain = 1e-5 * np.sin(2 * math.pi * 1003.0 * t) + noise
    rich = plain + 1e-8 * np.sin(2 * math.pi * 3009.0 * t)
    fundamental, none = superharmonics(*amplitude_spectrum(plain, 51200.0), (500.0, 3000.0))
    assert fundamental == pytest.approx(1003.0, abs=0.1)
    assert none == []
    found = superharmonics(*amplitude_spectrum(rich, 51200.0), (500.0, 2000.0))[1]
    assert [harmonic.order for harmonic in found] == [3]
    assert found[0].level == pytest.approx(-40.0, abs=0.1)


def test_the_page_holds_everything_itself(tmp_path):
    table = DataTable("numbers", "a < b", ("what", "value [N]"), [["<x>", 1.0], ["none", math.nan]])
    write_page("T", ["lead"], [Section("S", ["text & more"], [table])], tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "&lt;x&gt;" in text
    assert "src='http" not in text
    assert "<td>none</td>" in text
