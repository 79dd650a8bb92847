"""A rig's description, written and read."""

import pytest
import yaml
from ruamel.yaml import YAML

from squeal_rig.instruments.description import RigDescription
from squeal_rig.model import RigParameters

# ESC, line ends of YAML 1.1 and 1.2, what no YAML holds as it is, and what every YAML does.
TEXTS = ("a\x1b[31m", "a\tb\r\nc", "\x85\u2028\u2029", "\ufeff\ufffe\x7f\xa0", '"\\', "\u00e9\u6cb3\U0001f600", "")


@pytest.mark.parametrize("text", TEXTS, ids=ascii)
def test_any_text_in_a_description_is_read_as_it_was_written(text):
    rig = RigDescription(RigParameters(), preset=text, driver=text, sample_rate=6400)
    written = rig.to_yaml()
    assert RigDescription.from_yaml(written) == rig
    assert yaml.safe_load(written)["driver"] == text
    assert YAML(typ="safe", pure=True).load(written)["driver"] == text
