"""Drives the FMU of the reference actuator through the pre-flight test, as a master of FMPy.

python drive_fmu.py FMU OWN.csv OUT OTHER.fmu

OWN.csv is the same test by ema run (FSJ 3, zeta 0.3, 10 kHz), OTHER.fmu one of an actuator with effects. Writes the
tests that were driven into the folder OUT and says on standard output, as JSON, how far theta_m [rad] is from OWN.csv's
at most, and seconds.
"""

import json
import math
import sys
import time

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

FMU, OWN, OUT, OTHER = sys.argv[1:5]
STEP = 1e-4
ROWS = 30_000
BASIC = ["com", "theta_u", "theta_m", "omega_m", "i_eq", "i_a", "i_b", "i_c"]
PREFLIGHT = 2
FAULTS = {"fsj": 3.0, "zeta": 0.3}


def command(t):
    """Command of the pre-flight test [rad] and its derivatives [rad/s, rad/s2] from the time t [s] on."""
    w = 2.0 * math.pi * 5.0
    if t < 0.5 - 1e-9:
        return 0.001 * t, 0.001, 0.0
    if 0.85 - 1e-9 <= t < 1.85 - 1e-9:
        a = w * (t - 0.85)
        return 0.001 * math.sin(a), 0.001 * w * math.cos(a), -0.001 * w * w * math.sin(a)
    return (1.0 if t > 2.2 - 1e-9 else 0.0), 0.0, 0.0


class Slave:
    """An instance of the FMU in step mode."""

    def __init__(self, sequence=1):
        self.slave = FMU2Slave(
            guid=about.guid,
            unzipDirectory=folder,
            modelIdentifier=about.coSimulation.modelIdentifier,
            instanceName="unit",
        )
        self.slave.instantiate()
        self.slave.setupExperiment(startTime=0.0)
        self.slave.setReal([reference[n] for n in FAULTS], list(FAULTS.values()))
        self.slave.setInteger([reference["sequence"]], [sequence])
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def rows(self, drive=None, rows=range(ROWS), step=STEP):
        """Samples of all basic channels, one row a communication step."""
        wanted = [reference[n] for n in BASIC]
        out = []
        for k in rows:
            if drive:
                drive(self.slave, k * step)
            self.slave.doStep(currentCommunicationPoint=k * step, communicationStepSize=step)
            out.append(self.slave.getReal(wanted))
        return np.array(out)

    def end(self):
        self.slave.terminate()
        self.slave.freeInstance()


def interpolated(slave, t):
    u, first, second = command(t)
    vr = [reference["command"]]
    slave.setReal(vr, [u])
    slave.setRealInputDerivatives(vr, [1], [first + 0.5 * STEP * second])


def curved(slave, t):
    u, first, second = command(t)
    vr = [reference["command"]]
    slave.setReal(vr, [u])
    slave.setRealInputDerivatives(vr, [1], [first])
    slave.setRealInputDerivatives(vr, [2], [second])


def held(slave, t):
    slave.setReal([reference["command"]], [command(t)[0]])


def driven(name, drive, sequence=1):
    """A whole test, written as CSV."""
    s = Slave(sequence)
    begin = time.perf_counter()
    table = s.rows(drive)
    found["seconds_" + name] = time.perf_counter() - begin
    s.end()
    written(name, table)
    return table


def written(name, table):
    t = np.arange(1, len(table) + 1) * STEP
    head = "t," + ",".join(BASIC)
    np.savetxt(f"{OUT}/{name}.csv", np.column_stack([t, table]), delimiter=",", header=head, comments="", fmt="%.12g")
    found[name] = apart(table)


def apart(table):
    return float(np.max(np.abs(table[:, BASIC.index("theta_m")] - theta_m)))


found = {"problems": validate_fmu(FMU) + validate_fmu(OTHER)}
about = fmpy.read_model_description(FMU)
reference = {v.name: v.valueReference for v in about.modelVariables}
folder = fmpy.extract(FMU)
own = np.genfromtxt(OWN, delimiter=",", names=True)
theta_m = own["theta_m"]

driven("internal", None, PREFLIGHT)
driven("interpolated", interpolated)
driven("curved", curved)
driven("held", held)

# as a user who knows nothing of slaves does it
begin = time.perf_counter()
result = fmpy.simulate_fmu(
    FMU,
    start_values={**FAULTS, "sequence": PREFLIGHT},
    stop_time=3.0,
    output_interval=STEP,
    output=BASIC,
)
found["seconds_simulated"] = time.perf_counter() - begin
written("simulated", np.column_stack([result[n] for n in BASIC])[1:])
# another actuator, other parameters
fmpy.simulate_fmu(OTHER, start_values={"cogging.amplitude": 0.002, "cogging_2.phase": 1.0}, stop_time=0.01)

# a state that is put back, in memory and through bytes
s = Slave(PREFLIGHT)
s.rows(rows=range(9000))
state = s.slave.getFMUstate()
data = s.slave.serializeFMUstate(state)
found["state_bytes"] = len(data)
first = s.rows(rows=range(9000, 10_000))
s.slave.setFMUstate(state)
found["restored"] = float(np.max(np.abs(s.rows(rows=range(9000, 10_000)) - first)))
other = Slave(PREFLIGHT)
back = other.slave.deSerializeFMUstate(data)
other.slave.setFMUstate(back)
found["deserialized"] = float(np.max(np.abs(other.rows(rows=range(9000, 10_000)) - first)))
s.slave.freeFMUstate(state)
other.slave.freeFMUstate(back)
s.end()
other.end()

# steps of 1 ms
s = Slave(PREFLIGHT)
table = s.rows(rows=range(ROWS // 10), step=10 * STEP)
s.end()
found["millisecond"] = float(np.max(np.abs(table[:, BASIC.index("theta_m")] - theta_m[9::10])))
print(json.dumps(found))
