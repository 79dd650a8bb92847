"""A live campaign that is killed at random moments and resumed, beside the engine's: python -m benchmarks.live_campaign

Only the command is killed, by SIGKILL; the nodes that it has left end by themselves.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from squeal_rig.configuration.files import config_directory
from squeal_rig.experiments.campaign.plans import load_campaign
from squeal_rig.experiments.campaign.running import Where, run_direct, start
from squeal_rig.experiments.campaign.store import JOURNAL, journal, read
from tests.graph.domains import private_domain

# A kill comes within this time of a start [s]: so soon that a run of a minute does not end before it was killed ten
# times. No more starts than this.
LATEST, MOST_STARTS = 16.0, 60


def killed_live(plan: Path, folder: Path, kills: int, seed: int = 1, latest: float = LATEST) -> list[str]:
    """Run a plan live to its end, killed so many times on the way; what each start came to."""
    generator, endings = random.Random(seed), []
    with private_domain() as domain:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        for _ in range(MOST_STARTS):
            begun = (folder / JOURNAL).is_file() and bool(journal(folder))
            words = ["resume", str(folder)] if begun else ["run", str(plan), "--out", str(folder), "--live"]
            command = [sys.executable, "-m", "squeal_rig.cli", "campaign", *words]
            child = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
            left = kills - endings.count("killed")
            try:
                _, errors = child.communicate(timeout=generator.uniform(1.0, latest) if left else None)
            except subprocess.TimeoutExpired:
                child.kill()
                child.communicate()
                endings.append("killed")
                continue
            endings.append(errors.decode().strip() or "done")
            if child.returncode == 0:
                return endings
            time.sleep(2.0)
    return endings


def compare(folder: Path, other: Path) -> list[str]:
    """How the tables of two campaigns of one plan differ, in sentences."""
    a, b = read(folder, "points"), read(other, "points")
    chunks = Counter(entry["chunk"] for entry in journal(folder) if entry["what"] == "chunk")
    sentences = [f"{len(a['place'])} points of {len(b['place'])}, none twice: {set(chunks.values()) == {1}}"]
    wrong = [int(place) for place in a["place"][a["verdict"] != b["verdict"]]]
    sentences.append(f"other verdicts at places {wrong}" if wrong else "the same verdict at every point")
    for name, relative in (("frequency", True), ("level", False), ("squeal_from", True), ("squeal_to", True)):
        both = np.isfinite(a[name]) & np.isfinite(b[name]) & (b["verdict"] == "squeal")
        if both.any():
            off = a[name][both] / b[name][both] - 1.0 if relative else a[name][both] - b[name][both]
            sentences.append(f"{name}: off by at most {np.abs(off).max():.2g}{'' if relative else ' dB'}")
    return sentences


def main() -> None:
    """Run, and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live_campaign", description=__doc__)
    parser.add_argument("--plan", type=Path, default=config_directory() / "campaigns" / "smoke.yaml")
    parser.add_argument("--kills", type=int, default=10, help="how often it is killed (default: 10)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="where the campaigns are kept; a temporary one without")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        direct = start(folder / "direct", load_campaign(arguments.plan))
        run_direct(direct, Where(0), lambda progress: None)
        direct.close()
        endings = killed_live(arguments.plan, folder / "live", arguments.kills, arguments.seed)
        sys.stdout.write(json.dumps(endings, indent=1) + "\n" + "\n".join(compare(folder / "live", folder / "direct")))
        sys.stdout.write("\n")


if __name__ == "__main__":
    main()
