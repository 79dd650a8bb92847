"""Two small plans, and running one to its end."""

from squeal_rig.experiments.campaign.plans import parse_campaign
from squeal_rig.experiments.campaign.running import Where, run_direct, start
from squeal_rig.experiments.campaign.store import read

LEVELS = """
campaign: levels
rig: {damping_x: 1000.0, damping_y: 1000.0}
measure: level
factors:
  preload: {from: 20.0, to: 300.0}
  pad_stiffness: {from: 2.0e+7, to: 6.0e+7}
design: sobol
points: 32
protocol: [{start: 0.1}, {settle: {longest: 0.2}}, {dwell: 0.2}]
"""
EVENTS = """
campaign: events
rig: {damping_x: 1000.0, damping_y: 1000.0}
factors: {preload: [60.0, 120.0]}
protocol:
  - reset
  - hit: {impulse: 1.0e-7}
  - settle: {longest: 0.4, change: 0.5, over: 0.2}
  - dwell: 0.3
  - ramp: {parameter: preload, from: 120.0, to: 60.0, steps: 3, hold: 0.2, back: true}
"""


def finished(folder, text=LEVELS, chunk=4, where=None, tell=lambda progress: None):
    store = start(folder, parse_campaign(text, "plan"), chunk)
    try:
        run_direct(store, where or Where(0), tell)
    finally:
        store.close()
    return read(folder, "points")
