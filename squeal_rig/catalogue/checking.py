"""Checks any YAML file of ours: node parameters, a preset, a plan, data sheets, a driver's settings, springs, ..."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from squeal_rig.configuration.declared import D, Declared, declarations
from squeal_rig.configuration.files import load_yaml
from squeal_rig.configuration.node_files import RCLPY_NAMES, ROS_KEY, node_of, parameter_blocks, unknown_parameter
from squeal_rig.errors import ConfigurationError, DriverError, ParameterError
from squeal_rig.estimation.calibration.problem import load_calibration
from squeal_rig.estimation.calibration.targets import load_targets, looks_like_targets
from squeal_rig.estimation.settings import FrictionSettings, SquealSettings, StabilitySettings, ToneSettings
from squeal_rig.experiments.campaign.plans import load_campaign
from squeal_rig.experiments.plan import load_plan
from squeal_rig.experiments.springs import load_springs, looks_like_springs
from squeal_rig.instruments.data_sheets import data_sheets_of, load_data_sheets, looks_like_data_sheets
from squeal_rig.instruments.driver import driver_class
from squeal_rig.instruments.driver_config import DRIVER_KEY, check_driver_config
from squeal_rig.instruments.settings import PresetChoice, RigSettings
from squeal_rig.model.core.law import friction_refusal
from squeal_rig.model.parameters import RigParameters
from squeal_rig.page.settings import FoxgloveSettings, PageSettings
from squeal_rig.recording.settings import PlayerSettings, RecorderSettings
from squeal_rig.safety.settings import SupervisorSettings
from squeal_rig.view.settings import ViewSettings

#: Node name -> the dataclasses its parameters are declared in.
NODE_PARAMETERS: dict[str, tuple[type[Declared], ...]] = {
    "rig": (PresetChoice, RigParameters, RigSettings),
    "friction_estimator": (FrictionSettings,),
    "squeal_detector": (SquealSettings, ToneSettings),
    "stability": (StabilitySettings,),
    "supervisor": (SupervisorSettings,),
    "recorder": (RecorderSettings,),
    "player": (PlayerSettings,),
    "view": (ViewSettings,),
    "page": (PageSettings,),
    "foxglove": (FoxgloveSettings,),
}


def check_file(path: Path | str) -> str:
    """Check one file; returns in a few words what it is.

    Raises:
        ConfigurationError, ParameterError, DriverError: what is wrong with it, in one sentence.
    """
    content = load_yaml(path)
    if not isinstance(content, dict):
        raise ConfigurationError(f"{path}: expected a mapping, got {content!r}")
    if "campaign" in content:
        campaign = load_campaign(path)
        return f"a campaign of {campaign.design.count} points, at most {campaign.point_duration:g} s each"
    if "steps" in content:
        plan = load_plan(path)
        return f"a plan of {len(plan.steps)} steps and {plan.duration:g} s"
    if looks_like_springs(content) and "targets" not in content:
        return f"a catalogue of {len(load_springs(path))} springs"
    if looks_like_targets(content):
        return f"{len(load_targets(path).items)} targets of a calibration"
    if DRIVER_KEY in content:
        check_driver_config(str(path), str(content[DRIVER_KEY]))
        return f"settings of the driver {content[DRIVER_KEY]!r}"
    if "free" in content or "targets" in content:
        problem = load_calibration(path)
        return f"a calibration of {len(problem.free)} free parameters against {len(problem.targets.items)} targets"
    if looks_like_data_sheets(content):
        return f"data sheets of {len(data_sheets_of(content, path).analog) + 1} channels"
    if any(isinstance(value, dict) for value in content.values()):
        return "parameters of " + ", ".join(_check_node(path, key, value) for key, value in content.items())
    p = RigParameters.from_yaml(path)
    _refuse_friction(path, p)
    return "rig parameters"


def node_settings(path: Path | str, node: str, kind: type[D]) -> D:
    """A node's settings as a parameter file gives them, defaults where it does not."""
    values: dict[str, Any] = {}
    for key, block in parameter_blocks(load_yaml(path)):
        if node_of(key) == node:
            values |= {name: value for name, value in block.items() if name in declarations(kind)}
    return kind.from_mapping(values)


def _check_node(path: Path | str, key: str, body: object) -> str:
    """Check one block of a ROS parameter file; returns the name of its node, or what of it is for no node of ours."""
    name, where = node_of(str(key)), f"{path}, {key}"
    if not isinstance(body, dict) or set(body) != {ROS_KEY}:
        raise ConfigurationError(f"{where}: a node's block holds {ROS_KEY} and nothing else")
    values = next(block for _, block in parameter_blocks(body))
    values = {k: v for k, v in values.items() if k not in RCLPY_NAMES}
    if name and name not in NODE_PARAMETERS:
        raise ConfigurationError(f"{where}: no node {name!r}: there are {', '.join(NODE_PARAMETERS)}")
    if not str(key).startswith("/"):
        raise ConfigurationError(f"{where}: the key does not match a node in a namespace: write /**/{name}")
    try:
        if name:
            _check_values(path, NODE_PARAMETERS[name], values)
            return name
        return f"every node{_check_for_all(path, values)}"
    except (ParameterError, ConfigurationError, DriverError) as error:
        raise type(error)(f"{where}: {error}") from None


def _check_for_all(path: Path | str, values: Mapping[str, Any]) -> str:
    """Check what is for every node, as far as a node has it; the rest in words, which each of them passes over."""
    foreign = set(values)
    for kinds in NODE_PARAMETERS.values():
        own = {name: value for name, value in values.items() if any(name in declarations(kind) for kind in kinds)}
        _check_values(path, kinds, own)
        foreign -= own.keys()
    return f" (passed over: {', '.join(sorted(foreign))})" if foreign else ""


def _check_values(path: Path | str, kinds: tuple[type[Declared], ...], values: Mapping[str, Any]) -> None:
    known = {name: kind for kind in kinds for name in declarations(kind)}
    for name in values:
        if name not in known:
            raise unknown_parameter(str(name), known)
    for kind in kinds:
        own = {name: value for name, value in values.items() if known[name] is kind}
        base = RigParameters.preset(str(values.get("preset", "yavuz_sen_2023"))) if kind is RigParameters else None
        checked = kind.from_mapping(own, base)
        if isinstance(checked, RigSettings):
            driver_class(checked.driver)
            load_data_sheets(checked.instruments)
            if checked.driver_config:
                check_driver_config(checked.driver_config, checked.driver)
        if isinstance(checked, RigParameters):
            _refuse_friction(path, checked)


def _refuse_friction(path: Path | str, p: RigParameters) -> None:
    sentence = friction_refusal(p)
    if sentence:
        raise ParameterError(f"{path}: {sentence}")
