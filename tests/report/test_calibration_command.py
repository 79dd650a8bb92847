"""`squeal-rig calibrate`: tables on the console, a preset that can be read back, sentences for bad input."""

from io import StringIO

import pytest
from rich.console import Console

from squeal_rig.configuration.files import config_directory
from squeal_rig.errors import SquealRigError
from squeal_rig.model import RigParameters
from squeal_rig.studies.inverse.calibrate import Effort, run_calibration

PAPER = config_directory() / "paper" / "yavuz_sen_2023.yaml"


def test_the_preset_written_is_the_rig_found_and_names_its_command(tmp_path):
    out, text = tmp_path / "found.yaml", StringIO()
    found = run_calibration(PAPER, ["mass", "mu0=0.1:0.5"], Effort(3, 1, 25), out, Console(file=text, width=200))
    p = RigParameters.from_yaml(out)
    # Eight digits are written.
    assert p.mass == pytest.approx(found.rig.mass, rel=1e-7)
    assert p.mu0 == pytest.approx(found.rig.mu0, rel=1e-7)
    assert p.replace(mass=11.499, mu0=0.2501) == RigParameters.preset("yavuz_sen_2023")
    assert "--free mass,mu0=0.1:0.5 --seed 3 --starts 1 --generations 25" in out.read_text().splitlines()[1]
    assert "critical_pad_stiffness: mean" in text.getvalue()
    assert "singular values" in text.getvalue()


@pytest.mark.parametrize(
    ("free", "folder", "sentence"),
    [
        (["mas"], ".", "unknown parameter 'mas': did you mean 'mass'?"),
        (["mass=1"], ".", "write name, or name=lower:upper"),
        (["mass=5:1"], ".", "mass: bounds 5 to 1 must rise"),
        ([], "nowhere", "there is no folder"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(tmp_path, free, folder, sentence):
    out = tmp_path / folder / "found.yaml"
    with pytest.raises(SquealRigError) as refused:
        run_calibration(PAPER, free, Effort(1, 1, 5), out, Console(file=StringIO()))
    assert sentence in str(refused.value)
    assert not out.exists()
