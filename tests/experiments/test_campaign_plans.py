"""Campaign plans: what is refused and how, and which points a design has."""

from pathlib import Path

import numpy as np
import pytest

from squeal_rig.catalogue.checking import check_file
from squeal_rig.configuration.files import config_directory
from squeal_rig.errors import ConfigurationError
from squeal_rig.experiments.campaign.designs import Design, Factor
from squeal_rig.experiments.campaign.plans import load_campaign

FOLDER = Path(__file__).parent / "malformed_campaigns"
MALFORMED = sorted(FOLDER.glob("*.yaml"))


def test_there_are_at_least_thirty_malformed_plans():
    assert len(MALFORMED) >= 30


@pytest.mark.parametrize("path", MALFORMED, ids=lambda path: path.stem)
def test_a_malformed_plan_is_refused_with_file_key_and_reason(path):
    """The first two lines of each file say which key its sentence names, and what of the reason."""
    first, second, *_ = path.read_text(encoding="utf-8").splitlines()
    key, reason = first.removeprefix("# key:").strip(), second.removeprefix("# reason:").strip()
    with pytest.raises(ConfigurationError) as refused:
        load_campaign(path)
    sentence = str(refused.value)
    assert sentence.startswith(str(path))
    assert reason in sentence
    assert not key or f"{path}: {key}: " in sentence
    assert "\n" not in sentence


@pytest.mark.parametrize("name", ["smoke", "drag_matrix", "hysteresis"])
def test_what_ships_is_in_order(name):
    assert "a campaign of" in check_file(config_directory() / "campaigns" / f"{name}.yaml")


GRID = (Factor("a", (1.0, 2.0, 3.0)), Factor("b", (10.0, 20.0)))
SAMPLED = (Factor("a", low=1.0, high=2.0), Factor("b", low=1.0, high=100.0, log=True))


@pytest.mark.parametrize("order", ["as_given", "random", "serpentine"])
@pytest.mark.parametrize("by_hand", [(), ("b",)])
def test_every_order_has_every_point_once_in_each_repeat_whatever_the_chunks(order, by_hand):
    design = Design("grid", GRID, order=order, repeats=3, seed=4, by_hand=by_hand)
    whole = design.points(0, design.count)
    assert design.count == 18
    for repeat in range(3):
        assert sorted(whole[design.repeat_of(0, 18) == repeat]) == list(range(6))
    assert np.array_equal(np.concatenate([design.points(i, i + 5) for i in range(0, 18, 5)]), whole)
    if by_hand:
        values = design.values(whole[:6])["b"]
        assert np.count_nonzero(np.diff(values)) == 1


def test_neighbours_in_a_serpentine_differ_in_one_factor_by_one_level():
    design = Design("grid", (*GRID, Factor("c", (0.0, 1.0, 2.0, 3.0))), order="serpentine")
    where = np.array(np.unravel_index(design.points(0, design.count), design.shape))
    assert np.all(np.abs(np.diff(where, axis=1)).sum(axis=0) == 1)


@pytest.mark.parametrize("kind", ["latin_hypercube", "sobol"])
def test_a_sampled_design_fills_every_stratum_and_does_not_depend_on_the_chunks(kind):
    design = Design(kind, SAMPLED, samples=16, seed=2)
    whole = design.values(design.points(0, 16))
    parts = [design.values(design.points(i, i + 3)) for i in range(0, 16, 3)]
    for name, share in (("a", whole["a"] - 1.0), ("b", np.log10(whole["b"]) / 2.0)):
        assert sorted(np.floor(share * 16).astype(int)) == list(range(16))
        assert np.array_equal(np.concatenate([part[name] for part in parts]), whole[name])
