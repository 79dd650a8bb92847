"""A live campaign on a graph that is played: its points, its parameter file, and what is refused before it starts."""

import math
import textwrap
from types import SimpleNamespace

import numpy as np
import pytest

from squeal_rig.configuration.files import config_directory, load_yaml
from squeal_rig.errors import ExperimentError, NoHitError, SquealRigError
from squeal_rig.experiments.campaign.plans import parse_campaign
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import RigSettings

pytest.importorskip("rclpy")

from squeal_rig.session import campaign as live  # needs ROS

_RATE = 10_000
_SETTINGS = RigSettings(sample_rate=_RATE)
_BLOCK, _WINDOW = _RATE // 100, _RATE // 4
_BEFORE = 7 * _BLOCK  # sampled before anybody listens
_PLAN = """
campaign: small
rig: {preset: yavuz_sen_2023, preload: 60.0}
factors:
  belt_speed: [1.0]
protocol:
"""


class _Graph:
    """A quiet rig that does at once what it is told; its mu is a tenth of the belt speed, and tells the stiffness."""

    def __init__(self, base, missing=(), answers_after=0):
        self._answers_after = answers_after  # blocks
        self.set = base.as_mapping()
        self.state = SimpleNamespace(preload=0.0, belt_speed=0.0)
        self.windows, self.calls, self.on_samples = [], [], None
        self.seq, self._missing = _BEFORE, set(missing)
        self._window = []

    @property
    def description(self):
        return RigDescription(live.RigParameters.from_mapping(self.set), sample_rate=_RATE)

    def block(self):
        seq = np.arange(self.seq, self.seq + _BLOCK, dtype=np.uint32)
        self.seq += _BLOCK
        self.state.preload, self.state.belt_speed = self.set["preload"], self.set["belt_speed"]
        self._window.append((self.set["preload"], self.set["belt_speed"], self.mu()))
        if self.seq % _WINDOW == 0:
            preload, speed, mu = np.mean(self._window, axis=0)
            self._window.clear()
            self.windows.append(
                {
                    "t_start": (self.seq - _WINDOW) / _RATE, "t_end": self.seq / _RATE,
                    "preload": preload, "belt_speed": speed, "mu_ratio_of_means": mu,
                }
            )  # fmt: skip
        if self.seq // _BLOCK not in self._missing:
            x = 1e-9 * self.set["belt_speed"] * np.sin(2.0 * np.pi * 1000.0 * seq / _RATE)
            self.on_samples({"seq": seq, "x": x})

    def mu(self):
        return 0.1 * self.set["belt_speed"] + (0.5 if self.set["k1"] == 3e7 else 0.0)

    def sampled_time(self):
        return (self.seq - _BEFORE) / _RATE

    def wait_until(self, time):
        while self.sampled_time() < time:
            self.block()

    def wait_for(self, condition, what, timeout):
        if not self.comes(condition, timeout):
            raise ExperimentError(what)

    def comes(self, condition, _timeout):
        for _ in range(100):
            if condition():
                return True
            self.block()
        return False

    def set_parameters(self, values):
        self.calls.append(dict(values))
        for _ in range(self._answers_after):
            self.block()
        self.set |= values

    def change_springs(self, name, stiffness, dwell):
        self.calls.append((name, stiffness, dwell))
        self.set |= {"k1": stiffness, "k2": stiffness}
        self.seq = 0  # connected anew
        self.block()

    def call(self, service):
        assert service == "reset"
        first = self.seq
        return f"the pad rests at the equilibrium of what is in force from sample {first} on; tare forgotten"


class _Daq(dict):
    def __len__(self):
        return len(self["seq"])


def _campaign(protocol, **changes):
    text = _PLAN + textwrap.indent(textwrap.dedent(protocol), "  ")
    for old, new in changes.items():
        text = text.replace(old, new)
    return parse_campaign(text, "plan")


def _measured(campaign, missing=(), answers_after=0, **bench):
    """The row of a point with its steps' levels, the graph it was measured on, and what was told."""
    graph, kept = _Graph(campaign.base, missing, answers_after), {}
    under = live.LiveBench(graph, campaign.base, _SETTINGS, **bench)
    take = graph.on_samples
    graph.on_samples = lambda daq: take(_Daq(daq))
    graph.block()
    store = SimpleNamespace(campaign=campaign, add=lambda _place, tables: kept.update(tables))
    told = []
    live._point(store, under, graph, 0, "bags/0000", told.append)
    row = {name: values[0] for name, values in kept["points"].items()}
    return row | {"levels": kept["steps"].get("level")}, graph, told


def test_mu_is_that_of_the_dwell_not_of_where_a_ramp_has_led():
    ramps = """
        - reset
        - dwell: 0.5
        - ramp: {parameter: pad_stiffness, from: 6.0e+7, to: 3.0e+7, steps: 2, hold: 0.3}
        - ramp: {parameter: belt_speed, from: 2.0, to: 4.0, steps: 2, hold: 0.3}
    """
    row, _, _ = _measured(_campaign(ramps))
    assert row["verdict"] == "quiet"
    assert row["mu_measured"] == pytest.approx(0.1)


@pytest.mark.parametrize(
    "protocol",
    [
        "- reset\n- ramp: {parameter: pad_stiffness, from: 6.0e+7, to: 3.0e+7, steps: 2, hold: 0.3}\n",
        "- reset\n- settle: {longest: 0.4, change: 0.0, over: 0.4}\n- dwell: 0.2\n- ramp: "
        "{parameter: belt_speed, from: 2.0, to: 1.0, steps: 2, hold: 0.4}\n",
        "- reset\n- ramp: {parameter: belt_speed, from: 2.0, to: 4.0, steps: 2, hold: 0.3}\n- dwell: 0.5\n",
    ],
    ids=["no_dwell", "no_window_whole", "held_elsewhere"],
)
def test_without_a_window_within_the_dwell_at_the_point_there_is_no_mu(protocol):
    row, _, _ = _measured(_campaign(protocol))
    assert row["verdict"] == "quiet"
    assert math.isnan(row["mu_measured"])


def test_windows_are_found_where_the_sample_number_wraps():
    row, graph, _ = _measured(_campaign("- reset\n- dwell: 0.5\n"))
    under = live.LiveBench(graph, _campaign("- reset\n- dwell: 0.5\n").base, _SETTINGS)
    dwell = live._Dwell(2**32 - _BLOCK, 4 * _BLOCK, 60.0, 1.0, live.PointTolerance())
    assert row["mu_measured"] == pytest.approx(0.1)
    assert under._place(_BLOCK / _RATE, dwell) == 2 * _BLOCK
    assert under._place((2**32 + _BLOCK) / _RATE, dwell) == 2 * _BLOCK
    assert under._place((2**32 - 2 * _BLOCK) / _RATE, dwell) == -_BLOCK


@pytest.mark.parametrize("phase", ["dwell", "ramp"])
def test_nothing_is_measured_across_a_gap(phase):
    protocol = """
        - reset
        - dwell: 0.5
        - ramp: {parameter: belt_speed, from: 2.0, to: 4.0, steps: 2, hold: 0.5}
    """
    _, graph, _ = _measured(_campaign(protocol))
    last = graph.seq // _BLOCK
    assert last > 150
    first = last - (130 if phase == "dwell" else 30)
    row, _, _ = _measured(_campaign(protocol), missing=[first])
    assert (row["verdict"], row["lost_blocks"]) == ("quiet", 1)
    assert row["note"] == f"{_BLOCK} samples were lost; measured again"
    assert row["mu_measured"] == pytest.approx(0.1)
    row, _, _ = _measured(_campaign(protocol), missing=[first, first + 30])
    assert (row["verdict"], row["lost_blocks"]) == ("failed", 2)
    assert "nothing is measured across a gap" in row["note"]
    assert f"{2 * _BLOCK} samples were lost in 2 places; measured again" in row["note"]
    assert math.isnan(row["mu_measured"])


def test_what_was_lost_before_the_reset_is_told_and_harms_nothing():
    row, _, _ = _measured(_campaign("- reset\n- dwell: 0.5\n"), missing=[10])
    assert row["verdict"] == "quiet"
    assert row["note"] == f"{_BLOCK} samples were lost"
    assert row["lost_blocks"] == 1


@pytest.mark.parametrize("answers_after", [0, 100], ids=["at_once", "after_a_second"])
def test_a_step_is_judged_on_what_was_sampled_after_it_was_set_however_late_the_rig_answers(answers_after):
    speeds = np.array([1.0, 2.0, 3.0, 4.0])
    protocol = "- reset\n- ramp: {parameter: belt_speed, from: 1.0, to: 4.0, steps: 4, hold: 0.3}\n"
    row, _, _ = _measured(_campaign(protocol), answers_after=answers_after)
    assert row["levels"] == pytest.approx(20.0 * np.log10(1e-3 * speeds / np.sqrt(2.0)), abs=0.05)


def test_springs_are_fitted_by_hand_once_and_the_step_says_which():
    protocol = "- reset\n- dwell: 0.5\n- reset\n- dwell: 0.5\n"
    campaign = _campaign(protocol, **{"factors:": "by_hand: [pad_stiffness]\nfactors:\n  pad_stiffness: [3.0e+7]"})
    row, graph, told = _measured(campaign, by_hand=True)
    assert graph.calls[0] == ("3e+07 N/m", 3e7, math.inf)
    assert all("k1" not in call for call in graph.calls[1:])
    assert [call for call in graph.calls if isinstance(call, tuple)] == graph.calls[:1]
    assert "springs to fit: 3e+07 N/m" in told[0].facts["title"]
    assert (row["verdict"], row["note"], row["lost_blocks"]) == ("quiet", "", 0)
    assert row["mu_measured"] == pytest.approx(0.6)


# --- the parameter file

_FOR_ALL = f"/**:\n  ros__parameters:\n    sample_rate: {_RATE}\n    k1: 1.0e+7\n"
_LIVE_PLAN = _PLAN + "  - reset\n  - dwell: 0.5\n"


@pytest.mark.parametrize(
    "text",
    [
        _FOR_ALL,
        "/**/rig:\n  ros__parameters: {preload: 5.0}\n" + _FOR_ALL,
        "/**/squeal_detector:\n  ros__parameters: {on_level: -20.0}\n",
    ],
    ids=["for_all", "for_all_last", "no_rig"],
)
def test_the_rig_of_the_plan_is_written_whatever_blocks_there_are(tmp_path, text):
    (tmp_path / "mine.yaml").write_text(text)
    campaign = parse_campaign(_LIVE_PLAN, "plan")
    path, settings = live._ros_file(tmp_path / "rig_0000.yaml", tmp_path / "mine.yaml", campaign.base)
    blocks = load_yaml(path)
    assert list(blocks)[-1] == "/**/rig"  # the last one counts
    assert blocks["/**/rig"]["ros__parameters"].items() >= campaign.base.as_mapping().items()
    assert settings.sample_rate == (_RATE if "sample_rate" in text else RigSettings().sample_rate)


@pytest.fixture
def commands(in_process, tmp_path, monkeypatch):
    """The command line, whose live runs measure nothing; they are counted."""
    pages = pytest.importorskip("squeal_rig.experiments.campaign.pages")
    pytest.importorskip("pyarrow")
    runs = []
    monkeypatch.setattr(live, "run_live", lambda store, *_: runs.append(store.folder))
    monkeypatch.setattr(live, "SignalWatch", lambda: None)
    monkeypatch.setattr("squeal_rig.session.run.SignalWatch", lambda: None)
    monkeypatch.setattr("squeal_rig.graph.signals.ignore", lambda: None)
    monkeypatch.setattr(pages, "write_campaign_report", lambda folder: folder)
    (tmp_path / "plan.yaml").write_text(_LIVE_PLAN)

    def run(*arguments):
        return in_process("campaign", *arguments)

    run.runs, run.folder, run.plan = runs, tmp_path / "out", tmp_path / "plan.yaml"
    return run


def _refused(commands, *arguments, words):
    runs = len(commands.runs)
    code, _, errors = commands(*arguments)
    assert code == 2
    assert errors.count("\n") == 1
    assert "Traceback" not in errors
    assert words in errors
    assert len(commands.runs) == runs


def test_a_live_campaign_goes_on_with_the_parameters_that_it_was_begun_with(commands, tmp_path):
    mine, other = tmp_path / "mine.yaml", tmp_path / "other.yaml"
    mine.write_text(_FOR_ALL)
    other.write_text(_FOR_ALL.replace("1.0e+7", "2.0e+7"))
    assert commands("run", commands.plan, "--out", commands.folder, "--live", "--config", mine)[0] == 0
    kept = commands.folder / "rig_config.yaml"
    assert kept.read_text() == _FOR_ALL
    assert commands("resume", commands.folder)[0] == 0
    assert commands("resume", commands.folder, "--config", mine)[0] == 0
    assert kept.read_text() == _FOR_ALL
    _refused(commands, "resume", commands.folder, "--config", other, words="is not what the campaign was begun with")
    kept.unlink()
    _refused(commands, "resume", commands.folder, words="keeps no rig_config.yaml: give the --config")
    assert len(commands.runs) == 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("preload: 60.0\n", "has no block of a node"),
        ("{}\n", "has no block of a node"),
        ("- 1\n- 2\n", "expected a mapping"),
        ("a: [\n", "not valid YAML"),
        ("/**/rig:\n  preload: 60.0\n", "holds ros__parameters and nothing else"),
        ("/**/rig:\n  ros__parameters: {preload: -1.0}\n", "preload = -1"),
    ],
    ids=["no_block", "empty", "list", "no_yaml", "no_key", "out_of_bounds"],
)
def test_a_parameter_file_out_of_order_is_refused_before_anything_starts(commands, tmp_path, text, words):
    (tmp_path / "mine.yaml").write_text(text)
    arguments = ("run", commands.plan, "--out", commands.folder, "--live", "--config", tmp_path / "mine.yaml")
    _refused(commands, *arguments, words=words)
    assert not commands.folder.exists()


def test_levels_are_refused_live_before_anything_starts(commands):
    commands.plan.write_text(
        _LIVE_PLAN.replace("protocol:", "measure: level\nprotocol:").replace("- reset", "- start: 0.1")
    )
    _refused(commands, "run", commands.plan, "--out", commands.folder, "--live", words="measure: level is the engine's")
    assert not commands.folder.exists()


# --- what a driver cannot do

_SPRINGS = "by_hand: [pad_stiffness]\nfactors:\n  pad_stiffness: [3.0e+7, 6.0e+7]"


@pytest.mark.parametrize(
    ("protocol", "changes", "words"),
    [
        ("- reset\n- dwell: 0.5\n", {}, ""),
        ("- reset\n- dwell: 0.5\n", {"factors:": _SPRINGS}, ""),
        ("- reset\n- dwell: 0.5\n", {"factors:": _SPRINGS.replace("[pad_stiffness]", "[belt_speed]")}, "pad_stiffness"),
        ("- reset\n- dwell: 0.5\n", {"factors:": _SPRINGS.replace("pad_stiffness", "k1")}, "k1 cannot be moved"),
        (
            "- ramp: {parameter: pad_stiffness, from: 3.0e+7, to: 6.0e+7, steps: 2, hold: 0.3}\n",
            {"factors:": _SPRINGS},
            "pad_stiffness cannot be moved by this rig's driver",
        ),
        ("- reset\n- hit: {impulse: 0.1}\n- dwell: 0.5\n", {}, "cannot give the pad an impact"),
    ],
    ids=["speed", "springs_by_hand", "springs", "one_spring", "spring_ramp", "hit"],
)
def test_what_hardware_cannot_do_is_refused_before_anything_starts(monkeypatch, protocol, changes, words):
    can = SimpleNamespace(set_points=frozenset(("preload", "belt_speed")), can_hit=False)
    monkeypatch.setattr(live, "driver_class", lambda _name: lambda: SimpleNamespace(capabilities=lambda _settings: can))
    campaign, config = _campaign(protocol, **changes), config_directory() / "rig.yaml"
    if words:
        with pytest.raises(SquealRigError, match=words):
            live.live_config(campaign, config)
    else:
        assert live.live_config(campaign, config) == config.read_text(encoding="utf-8")


# --- what is no answer


@pytest.mark.parametrize(
    ("error", "ends"),
    [
        (NoHitError("there is no smallest hit here: the zone of the set point is 'quiet'"), False),
        (ExperimentError("waited 60 s in vain for the smallest hit of the set point"), True),
        (ExperimentError("the supervisor has tripped, which ends the plan: ramp down"), True),
    ],
    ids=["none", "late", "trip"],
)
def test_only_a_zone_without_hits_is_told_as_none(error, ends):
    def refused():
        raise error

    graph = SimpleNamespace(smallest_hit=refused)
    under = live.LiveBench(graph, _campaign("- reset\n- dwell: 0.5\n").base, _SETTINGS)
    if ends:
        with pytest.raises(ExperimentError, match=str(error)):
            under.smallest_hit()
    else:
        assert np.isnan(under.smallest_hit()).all()
