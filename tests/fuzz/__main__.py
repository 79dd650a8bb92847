"""Runs the fuzz suite: `python -m tests.fuzz [--minutes 2] [--seed N] [--only bags,graph] [--again FOLDER]`."""

import argparse
import hashlib
import importlib
import math
import random
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded

from . import Case
from .bounded import BoundedChild

#: Classes of input, and the share of the time that each gets.
SHARES = {"bags": 0.36, "records": 0.14, "yaml_files": 0.16, "graph": 0.34}
FINDINGS = Path("fuzz_findings")
_BATCH = 20  # examples of one seed
_KEPT = 3  # inputs saved of one finding


class Findings:
    """Counts findings by what they are, and saves the first inputs of each."""

    def __init__(self):
        self.counts = Counter()

    def add(self, kind, case, text):
        name = signature(text)
        self.counts[kind, name] += 1
        if self.counts[kind, name] > _KEPT:
            return
        digest = hashlib.sha256(name.encode()).hexdigest()[:8]
        folder = FINDINGS / f"{kind}_{digest}_{self.counts[kind, name]}"
        shutil.rmtree(folder, ignore_errors=True)
        (folder / "input").mkdir(parents=True)
        for file, data in case.files.items():
            (folder / "input" / file).write_bytes(data)
        facts = "".join(f"{key}: {value}\n" for key, value in case.facts.items())
        (folder / "facts.txt").write_text(facts, encoding="utf-8")
        (folder / "finding.txt").write_text(text, encoding="utf-8", errors="replace")
        _tell(f"  FOUND {name}\n        {folder}")


def signature(text):
    """A finding in one line, the same for all inputs that show it: what was tried, the error, where in the package."""
    first, *lines = text.strip().splitlines()
    places = re.findall(r'File ".*?(squeal_rig/[\w/]+\.py)", line (\d+)', text)
    error = next((line for line in reversed(lines) if re.match(r"[\w.]+(Error|Exception|Exit|Interrupt)\b", line)), "")
    where = f" at {places[-1][0]}:{places[-1][1]}" if places else ""
    return re.sub(r"0x[0-9a-f]+|\d{5,}|/tmp/\S+", "#", f"{first} {error.partition(':')[0]}{where}".strip())[:200]


def run_class(kind, seed, seconds, batches, corpus, findings):
    """Try inputs of one class until its time is over or so many batches are tried; returns how many."""
    module = importlib.import_module(f"tests.fuzz.{kind}")
    module.make_corpus(corpus)
    child = getattr(module, "Tester", BoundedChild)(kind, corpus)
    size = getattr(module, "count", lambda _: 1)
    count = 0

    def examine(case):
        nonlocal count
        if time.monotonic() < deadline:
            count += size(case)
            for text in child.examine(case):
                findings.add(kind, case, text)

    try:
        child.start()
        deadline = time.monotonic() + seconds
        made = list(module.made(corpus))
        random.Random(seed).shuffle(made)
        batch = 0
        while time.monotonic() < deadline and batch < batches:
            run = given(module.cases(corpus))(examine)
            # Not one of hypothesis' own limits: no input is too large or too slow for what is tried here.
            limits = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}
            seeded(f"{seed}/{batch}")(settings(max_examples=_BATCH, phases=[Phase.generate], **limits)(run))()
            batch += 1
            # Between the others, since some take their time; all of them where batches are counted.
            for _ in range(math.ceil(len(made) / (batches - batch + 1)) if batches < math.inf else min(1, len(made))):
                case = made.pop()
                examine(case() if callable(case) else case)
    finally:
        for text in child.close():
            findings.add(kind, Case({}), text)
    return count


def try_again(folder):
    """Try a saved input once more; returns its findings."""
    kind = folder.name.rpartition("_")[0].rpartition("_")[0]
    module = importlib.import_module(f"tests.fuzz.{kind}")
    files = {path.name: path.read_bytes() for path in sorted((folder / "input").iterdir())}
    lines = (folder / "facts.txt").read_text(encoding="utf-8").splitlines()
    case = Case(files, dict(line.split(": ", 1) for line in lines if ": " in line))
    with tempfile.TemporaryDirectory() as corpus:
        module.make_corpus(Path(corpus))
        child = getattr(module, "Tester", BoundedChild)(kind, Path(corpus))
        try:
            return child.examine(case)
        finally:
            child.close()


def _tell(text):
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    parser.add_argument("--minutes", type=float, default=2.0, help="time in all, without what is made first")
    parser.add_argument("--seed", type=int, help="the same seed gives the same inputs, as far as the time goes")
    parser.add_argument("--batches", type=int, help="of each class at most: the same inputs on every machine")
    parser.add_argument("--only", default=",".join(SHARES), help="classes, by commas")
    parser.add_argument("--again", type=Path, help="try a saved input once more")
    options = parser.parse_args()
    if options.again is not None:
        found = try_again(options.again)
        _tell("\n".join(found) or "nothing found")
        return 1 if found else 0
    seed = random.SystemRandom().randrange(2**32) if options.seed is None else options.seed
    chosen = options.only.split(",")
    whole = sum(SHARES[kind] for kind in chosen)
    _tell(f"seed {seed}, {options.minutes:g} minutes")
    findings, tried = Findings(), {}
    with tempfile.TemporaryDirectory(prefix="squeal_rig_fuzz_") as folder:
        for kind in chosen:
            corpus = Path(folder) / kind
            corpus.mkdir()
            begin = time.monotonic()
            seconds = 60.0 * options.minutes * SHARES[kind] / whole
            # An input of the graph takes a second: half as many batches there.
            batches = math.inf if not options.batches else math.ceil(options.batches / (2 if kind == "graph" else 1))
            tried[kind] = run_class(kind, seed, seconds, batches, corpus, findings)
            _tell(f"{kind}: {tried[kind]} inputs tried in {time.monotonic() - begin:.0f} s")
    _tell(f"inputs: {', '.join(f'{kind} {count}' for kind, count in tried.items())}; seed {seed}")
    for (kind, name), count in sorted(findings.counts.items()):
        _tell(f"FOUND {count} times, {kind}: {name}")
    _tell(f"{len(findings.counts)} findings" + (f", inputs in {FINDINGS}/" if findings.counts else ""))
    return 1 if findings.counts else 0


if __name__ == "__main__":
    sys.exit(main())
