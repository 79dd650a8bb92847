"""The commands `cycles` and `map`: settings, and one sentence with exit code 2 for what cannot be."""

import pytest

from squeal_rig.configuration.arguments import assignments, span
from squeal_rig.errors import ParameterError
from squeal_rig.model.parameters import RigParameters

DAMPED = ["--set", "damping_x=1000", "--set", "damping_y=1000"]

REFUSED = {
    "undamped": (["cycles"], "need damping: with damping_x = 0 and damping_y = 0 N s/m nothing dies out"),
    "undamped_map": (["map", "--set", "damping_x=20"], "with damping_x = 20 and damping_y = 0 N s/m"),
    "slip": (["cycles", *DAMPED, "friction_direction=slip"], "friction_direction = slip"),
    "slip_map": (["map", *DAMPED, "friction_speed=slip"], "friction_speed = slip"),
    "no_setting": (["map", "--set", "damping_x"], "'damping_x' is no setting: write name=value"),
    "stray_word": (["cycles", *DAMPED, "mu0"], "'mu0' is no setting: write name=value"),
    "no_number": (["map", "--set", "mass=heavy"], "mass = 'heavy' is not a number"),
    "nan": (["map", *DAMPED, "preload=nan"], "preload = nan N is not finite"),
    "unknown": (["cycles", "--set", "dampin_x=1"], "unknown parameter 'dampin_x': did you mean 'damping_x'?"),
    "twice": (["cycles", *DAMPED, "damping_x=3"], "damping_x is set twice, to 1000.0 and to 3"),
    "preset": (["map", *DAMPED, "--preset", "nobodys"], "no preset 'nobodys': there are yavuz_sen_2023,"),
    "field": (["cycles", *DAMPED, "--over", "masss"], "'masss' is no numeric field of a rig"),
    "text_field": (["cycles", *DAMPED, "--over", "friction_speed"], "'friction_speed' is no numeric field"),
    "range": (["cycles", *DAMPED, "--within", "3"], "'3' is no range of mu0: write low:high"),
    "range_beside": (["cycles", *DAMPED, "--within", "3:4"], "must be two numbers with 0.2501 between them"),
    "range_backwards": (["map", *DAMPED, "--preload", "300:10"], "'300:10' is no range of preload [N]"),
    "range_outside": (["map", *DAMPED, "--speed", "1:400"], "m/s is out of bounds: it must be 0 to 20 m/s"),
    "no_cycle": (
        ["cycles", *DAMPED, "--preset", "yavuz_sen_2023_as_printed"],
        "there is no squeal cycle to follow in mu0: the motion dies out",
    ),
    "negative_friction": (["map", *DAMPED, "mu0=-1"], "the friction law gives mu = -0.9"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_is_one_sentence_and_leaves_no_folder(in_process, tmp_path, name):
    arguments, sentence = REFUSED[name]
    code, output, errors = in_process(*arguments, "--out", tmp_path / "out")
    assert (code, output) == (2, "")
    assert errors.startswith("squeal-rig: ")
    assert errors.count("\n") == 1
    assert sentence in errors
    assert not (tmp_path / "out").exists()


def test_a_folder_to_write_to_is_asked_for(in_process):
    for command in ("cycles", "map"):
        code, _, errors = in_process(command, *DAMPED)
        assert code == 2
        assert "--out" in errors


@pytest.mark.slow
def test_settings_may_follow_each_other_or_each_have_its_option(in_process, tmp_path):
    texts = []
    for number, words in enumerate((DAMPED, ["--set", "damping_x=1000", "damping_y=1000"])):
        code, output, errors = in_process("cycles", *words, "--out", tmp_path / str(number), "--within", "0.2:0.3")
        assert (code, errors) == (0, "")
        assert "Zone: bistable" in output
        texts.append((tmp_path / str(number) / "branch.csv").read_text(encoding="utf-8"))
    assert texts[0] == texts[1]


def test_nothing_is_overwritten_without_force_and_no_link_is_followed(in_process, tmp_path):
    precious, out = tmp_path / "precious.txt", tmp_path / "out"
    precious.write_text("the user's", encoding="utf-8")
    out.mkdir()
    (out / "branch.csv").symlink_to(precious)
    arguments = ["cycles", *DAMPED, "--within", "0.2:0.3", "--out", out]
    code, _, errors = in_process(*arguments)
    assert (code, "is not empty; --force" in errors) == (2, True)
    code, _, errors = in_process(*arguments, "--force")
    assert (code, errors) == (0, "")
    assert not (out / "branch.csv").is_symlink()
    assert precious.read_text(encoding="utf-8") == "the user's"
    code, _, errors = in_process(*arguments[:-1], precious, "--force")
    assert (code, "is no folder" in errors) == (2, True)
    code, _, errors = in_process(*arguments[:-1], precious / "below", "--force")
    assert (code, errors.count("\n")) == (2, 1)
    assert precious.read_text(encoding="utf-8") == "the user's"


def test_words_of_the_command_line_are_read_as_they_are_meant():
    assert assignments(["mass=1e1", " k1 = 2 ", "friction_speed=slip"]) == {
        "mass": 10.0, "k1": 2.0, "friction_speed": "slip",
    }  # fmt: skip
    assert RigParameters.chosen("yavuz_sen_2023", ["pad_stiffness=2e7"]).k2 == 2e7
    assert span("1:2.5", "speed") == (1.0, 2.5)
    assert span("-1:-0.5", "mu0") == (-1.0, -0.5)
    for word in ("", ":", "1", "1:", ":2", "2:1", "1:1", "1:2:3", "nan:1", "0:inf", "a:b"):
        with pytest.raises(ParameterError, match="is no range of speed"):
            span(word, "speed", "m/s")
    for word in ("", "=", "a", "a=", "=1"):
        with pytest.raises(ParameterError, match="is no setting"):
            assignments([word])
