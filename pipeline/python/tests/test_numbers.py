"""The same numbers as the program, to the last bit."""

import csv
import json
import math
import struct
import subprocess
import unittest

import ema
from common import Folder, PROGRAM, needs, needs_program, program, told


def bits(values):
    return [struct.pack("<d", float(x)) for x in values]


@needs_program
class Numbers(Folder):
    def test_a_run_is_that_of_the_program(self):
        path = self.file("run.csv")
        program("run", "--fsj", 2.2, "--zeta", 0.27, "--sensors", "reference", "--seed", 7, "--channels", "torque_m", "--out", path)
        run = ema.run(fsj=2.2, zeta=0.27, sensors="reference", seed=7, channels=["torque_m"])
        with open(path, newline="") as f:
            rows = list(csv.reader(f))
        names, rows = rows[0], rows[1:]
        self.assertEqual(names[1:], run.columns[5:])
        self.assertEqual(len(rows), len(run))
        for k, name in enumerate(names[1:], 1):
            # the file has twelve digits
            ours = [float(f"{float(x):.11e}") for x in run[name]]
            self.assertEqual(bits(ours), bits(row[k] for row in rows), name)

    @needs("pyarrow")
    def test_a_run_has_every_bit_of_the_programs_parquet(self):
        import pyarrow.parquet

        for sensors in (None, "reference"):
            path = self.file("run.parquet")
            program("run", "--fsj", 3, "--zeta", 0.3, "--sensors", sensors or "none", "--rest-angle-deg", 40, "--load-n-m", 0.02, "--out", path)
            theirs = pyarrow.parquet.read_table(path)
            ours = ema.run(fsj=3, zeta=0.3, sensors=sensors, rest_angle_deg=40, load_n_m=0.02)
            table = pyarrow.table(ours)
            self.assertEqual(table.column_names, theirs.column_names)
            for name in table.column_names:
                self.assertTrue(table[name].combine_chunks().equals(theirs[name].combine_chunks()), name)
                self.assertEqual(table[name].type, theirs[name].type)
            theirs = pyarrow.parquet.read_metadata(path).metadata
            theirs = {k.decode(): v.decode() for k, v in theirs.items() if k.startswith(b"ema.")}
            # of values as they lie in a file
        theirs.pop("ema.checksums")
        self.assertEqual(ours.metadata, theirs)

    @needs("pyarrow")
    def test_the_simplified_model_has_the_programs_samples(self):
        import pyarrow

        path = self.file("sm.parquet")
        program("run", "--model", "sm", "--out", path)
        ours = pyarrow.table(ema.run(model="sm"))
        theirs = pyarrow.parquet.read_table(path)
        self.assertEqual(ours.column_names, theirs.column_names)
        self.assertTrue(all(ours[n].combine_chunks().equals(theirs[n].combine_chunks()) for n in ours.column_names))
        with self.assertRaises(ema.InputError):
            ema.run(model="sm", fsj=2)
        with self.assertRaises(ema.InputError):
            ema.run(model="other")

    @needs("pyarrow")
    def test_a_sweep_is_a_dataset_of_the_program(self):
        import pyarrow.parquet

        grid = self.file("grid.toml")
        with open(grid, "w") as f:
            f.write('name = "g"\nfsj = [1.0, 2.0, 3.5]\nzeta = [0.0, 0.2]\n')
        for sensors in (None, "reference"):
            out = self.file(f"dataset-{sensors}")
            program("simulate", "--grid", grid, "--sensors", sensors or "none", "--seed", 3, "--out", out)
            theirs = pyarrow.parquet.read_table(f"{out}/features/part-0000.parquet")
            features, samples = ema.sweep(grid=grid, sensors=sensors, seed=3, telemetry=True)
            self.assertEqual(len(features), 6)
            for name in features.columns:
                if name == "run":
                    continue
                column = theirs[name].to_pylist()
                self.assertEqual(bits(features[name]), bits(math.nan if x is None else x for x in column), name)
            theirs = pyarrow.parquet.read_table(f"{out}/telemetry", partitioning=None).sort_by([("run", "ascending"), ("t_ns", "ascending")])
            ours = pyarrow.table(samples)
            self.assertEqual(theirs.num_rows, ours.num_rows)
            for name in set(theirs.column_names) & set(ours.column_names):
                a, b = (t[name].cast("float64").combine_chunks() for t in (theirs, ours))
                self.assertTrue(a.equals(b), name)

    def test_a_diagnosis_has_every_bit_of_the_programs(self):
        path = self.file("run.parquet")
        for fsj, zeta, sensors in [(3, 0.3, "reference"), (1, 0, "reference"), (4.9, 0.02, "none")]:
            program("run", "--fsj", fsj, "--zeta", zeta, "--sensors", sensors, "--out", path)
            theirs = told("diagnose", path, "--json")
            self.assertEqual(ema.diagnose(path), theirs)
            self.assertEqual(ema.diagnose(ema.run(fsj=fsj, zeta=zeta, sensors=sensors)), theirs)
        self.assertEqual(ema.diagnose(path, method="paper"), json.loads(program("diagnose", path, "--json", "--method", "paper")))
        narrow = told("diagnose", path, "--json", "--coverage", 0.8)
        self.assertEqual(ema.diagnose(path, coverage=0.8), narrow)

    def test_a_test_that_nothing_explains_names_the_next_command(self):
        stuck = ema.Actuator().with_(backlash_half_width_rad=4e-5, name="stuck")
        test = ema.run(stuck, fsj=2, zeta=0.1, sensors="reference")
        path = self.file("run.csv")
        columns = ["com", "theta_u", "theta_m", "omega_m", "i_eq", "i_a", "i_b", "i_c"]
        with open(path, "w") as f:
            f.write("t," + ",".join(columns) + "\n")
            for n, row in enumerate(zip(*(test[c] for c in columns)), 1):
                f.write(",".join([repr(n / 1e4), *(repr(float(x)) for x in row)]) + "\n")
        theirs = told("diagnose", path, "--json")
        self.assertEqual(theirs["outcome"], "unexplained")
        self.assertEqual(ema.diagnose(path), theirs)
        plain = {"t": [n / 1e4 for n in range(1, len(test) + 1)], **{c: test[c] for c in columns}}
        ours = ema.diagnose(plain)
        self.assertEqual(ours.pop("next_command"), "ema discrepancy --actuator reference --bench table --out study")
        theirs.pop("next_command")
        self.assertEqual(ours, theirs)

    def test_maps_are_the_programs(self):
        maps = ema.maps(grid="coarse", progress=False)
        self.assertIn("rise", maps.features)
        folder = self.file("saved")
        maps.save(folder)
        run = self.file("run.parquet")
        program("run", "--fsj", 2, "--zeta", 0.2, "--sensors", "reference", "--out", run)
        theirs = told("diagnose", run, "--json", "--maps", folder)
        for given in (maps, folder, ema.Maps.load(folder)):
            self.assertEqual(ema.diagnose(run, maps=given), theirs)
        table = maps.table()
        self.assertEqual(table.columns, ["feature", "fsj", "zeta", "value", "raw_value"])
        self.assertEqual(len(table) % 15, 0)

    def test_a_unit_is_the_programs(self):
        tests = []
        for k, (fsj, zeta) in enumerate([(1, 0), (1, 0), (2, 0.1)]):
            tests.append(self.file(f"run{k}.parquet"))
            program("run", "--fsj", fsj, "--zeta", zeta, "--sensors", "reference", "--seed", k, "--out", tests[-1])
        ours, theirs = self.file("ours.json"), self.file("theirs.json")
        ema.unit.new(ours, name="tail7")
        program("unit", "new", theirs, "--name", "tail7")
        ema.unit.update(ours, tests[:2], healthy=True)
        program("unit", "update", theirs, *tests[:2], "--healthy")
        a, b = ema.unit.show(ours), told("unit", "show", theirs, "--json")
        self.assertEqual(a, b)
        self.assertEqual(a["healthy_tests"], 2)
        self.assertEqual(ema.diagnose(tests[2], unit=ours), told("diagnose", tests[2], "--unit", theirs, "--json"))
        with self.assertRaises(ema.InputError):
            ema.unit.new(ours)

    def test_a_study_is_the_programs(self):
        rig = ema.Actuator().with_(viscous_n_m_s_per_rad=6e-5, name="rig")
        model = self.file("rig.toml")
        with open(model, "w") as f:
            f.write(rig.to_toml())
        runs = []
        for k in range(2):
            runs.append(self.file(f"run{k}.parquet"))
            program("run", "--actuator", model, "--sensors", "reference", "--seed", k, "--sequence", "multisine", "--out", runs[-1])
        theirs = told("discrepancy", "--model", "reference", "--bench", *runs, "--healthy", "--json", "--out", self.file("theirs"))
        ours = ema.discrepancy(*runs, model="reference", healthy=True, out=self.file("ours"))
        for told_ in (ours, theirs):
            # names of folders
            told_.pop("next_command", None)
            told_.pop("next", None)
        text = json.dumps(ours).replace(self.file("ours"), "OUT")
        self.assertEqual(text, json.dumps(theirs).replace(self.file("theirs"), "OUT"))

    def test_a_prognosis_is_the_programs(self):
        rows = [{"cycle": float(k), "fsj_lo": 1 + 0.02 * k - 0.05, "fsj_estimate": 1 + 0.02 * k, "fsj_hi": 1 + 0.02 * k + 0.05} for k in range(1, 60)]
        path = self.file("history.csv")
        with open(path, "w", newline="") as f:
            w = csv.DictWriter(f, list(rows[0]))
            w.writeheader()
            w.writerows(rows)
        said = subprocess.run([PROGRAM, "prognosis", path, "--threshold", "fsj=4", "--json"], capture_output=True, text=True, check=True)
        theirs = [json.loads(line) for line in said.stdout.splitlines()]
        ours = ema.prognosis(path, {"fsj": 4})
        self.assertEqual(ours, theirs)
        self.assertEqual(ours[0]["status"], "ok")
        table = {"actuator": ["history"] * len(rows), **{k: [r[k] for r in rows] for k in rows[0]}}
        self.assertEqual(ema.prognosis(table, {"fsj": 4}), theirs)


if __name__ == "__main__":
    unittest.main()
