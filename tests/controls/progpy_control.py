"""progpy as a control: its particle filter and its Monte Carlo predictor on the same histories as `ema prognosis score`.

    python progpy_control.py HISTORY.csv TRUTH.csv [units]

HISTORY has actuator, cycle, fsj_lo, fsj_hi, fsj_estimate; TRUTH has actuator, cycle. The model is damage u that grows by
exp(r) (0.2 + u) a cycle, r the unknown log rate: as general as one law of progpy's can be. What progpy leaves to its user was
set here: 1000 particles, process noise 0.002 of damage and 0.03 of r a cycle, measurement noise at least 0.01 (with the
diagnosis' own, 0.0003, all particles but one die at the first jump). Prints CRPS over the remaining life.
"""

import csv
import sys
import warnings
from collections import defaultdict

import numpy as np
from progpy import PrognosticsModel
from progpy.predictors import MonteCarlo
from progpy.state_estimators import ParticleFilter
from progpy.uncertain_data import MultivariateNormalDist

warnings.filterwarnings("ignore")
HEALTHY, THRESHOLD, HORIZON, SAMPLES = 1.0, 4.0, 2000.0, 100


class Wear(PrognosticsModel):
    inputs, states, outputs, events = [], ["u", "r"], ["u"], ["end"]
    is_vectorized = True
    default_parameters = {"x0": {"u": 0.0, "r": -5.0}, "process_noise": {"u": 0.002, "r": 0.03}, "measurement_noise": {"u": 0.01}}

    def next_state(self, x, u, dt):
        rate = np.exp(np.clip(x["r"], -12.0, 0.0))
        return self.StateContainer({"u": x["u"] + dt * rate * (0.2 + np.clip(x["u"], 0.0, 1.5)), "r": x["r"]})

    def output(self, x):
        return self.OutputContainer({"u": x["u"]})

    def event_state(self, x):
        return {"end": 1.0 - x["u"]}

    def threshold_met(self, x):
        return {"end": x["u"] >= 1.0}


def crps(times, truth):
    times = np.minimum(np.sort(np.asarray(times, float)), HORIZON)
    n = len(times)
    spread = np.sum((2 * np.arange(1, n + 1) - n - 1) * times) / n**2
    return np.mean(np.abs(times - truth)) - spread


def predicted(model, state):
    answer = MonteCarlo(model).predict(state, n_samples=SAMPLES, dt=2.0, horizon=HORIZON, events=["end"])
    ends = [t["end"] for t in answer.time_of_event]
    return [HORIZON if t is None else t for t in ends]  # never is late, not left out


def main(history, truth, most):
    np.random.seed(1)
    ends = {r["actuator"]: float(r["cycle"]) for r in csv.DictReader(open(truth))}
    rows = defaultdict(list)
    for r in csv.DictReader(open(history)):
        if r["fsj_estimate"] and r["actuator"] in ends:
            rows[r["actuator"]].append((float(r["cycle"]), (float(r["fsj_estimate"]) - HEALTHY) / (THRESHOLD - HEALTHY)))
    lambdas = (0.25, 0.5, 0.75)
    scores = {k: [] for k in lambdas}
    for unit in sorted(rows)[:most]:
        tests, end = sorted(rows[unit]), ends[unit]
        model = Wear()
        start = MultivariateNormalDist(["u", "r"], [tests[0][1], -5.0], np.diag([1e-4, 1.0]))
        pf = ParticleFilter(model, start, t0=tests[0][0] - 1e-3, num_particles=1000, measurement_noise={"u": 0.01})
        left = list(lambdas)
        last = tests[0][0]
        for at, u in tests[1:]:
            while left and at > left[0] * end:
                share = left.pop(0)
                times = predicted(model, pf.x)
                scores[share].append(crps(times, end - last) / (end - last))
            if at > last:
                pf.estimate(at, {}, {"u": u}, dt=at - last)
                last = at
    for share, s in scores.items():
        print(f"{share}: {len(s)} units, CRPS / RUL mean {np.mean(s):.3f}, median {np.median(s):.3f}")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]) if len(sys.argv) > 3 else 10**9)
