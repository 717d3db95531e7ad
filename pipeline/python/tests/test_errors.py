"""Refusals say file, place, what is found and what is allowed."""

import pickle
import unittest

import ema
from common import Folder


class Errors(Folder):
    def refused(self, call, *arguments, **named):
        with self.assertRaises(ema.InputError) as caught:
            call(*arguments, **named)
        e = caught.exception
        self.assertIsInstance(e, ValueError)
        # a torn file has one sentence
        if ": found " in str(e):
            for text in (e.file, e.place, e.found[:40], e.allowed):
                self.assertIn(text, str(e))
        self.assertEqual(str(e).count("\n"), 0)
        return e

    def test_arguments(self):
        e = self.refused(ema.run, zeta=1.5)
        self.assertEqual((e.file, e.place, e.found), ("arguments", "zeta", "1.5"))
        self.assertIn("0 <= zeta < 1", e.allowed)
        e = self.refused(ema.run, sequence="dance")
        self.assertIn("preflight", e.allowed)
        self.assertEqual(self.refused(ema.run, channels=["x"]).place, "channels")
        self.assertEqual(self.refused(ema.run, rest_angle_deg=float("nan")).place, "rest_angle_deg")
        self.assertEqual(self.refused(ema.run, rate_hz=1e9).place, "rate")
        self.refused(ema.run, rate_hz=0.0)
        self.refused(ema.run, sensors="none.toml.txt")
        self.refused(ema.sweep, fsj=[2.0, 1.0])
        self.refused(ema.sweep, fsj=[], zeta=[0.0])
        self.refused(ema.sweep, zeta=[float("nan")])
        self.refused(ema.sweep, rate_hz=10.0)
        self.refused(ema.maps, fsj=[2.0, 3.0], zeta=[0.0, 0.1])
        self.refused(ema.Actuator().with_, gear_ratio=-1)
        self.refused(ema.Actuator().with_, gear=1)
        test = ema.run(fsj=2)
        self.assertEqual(self.refused(ema.diagnose, test, coverage=1.5).place, "coverage")
        self.assertEqual(self.refused(ema.diagnose, test, method="guess").place, "method")
        self.assertEqual(self.refused(ema.diagnose, test, known={"colour": 1.0}).file, "arguments")
        self.refused(ema.diagnose, test, maps=3)
        self.refused(ema.discrepancy)
        self.refused(ema.prognosis, {"cycle": [1.0], "fsj_lo": [1.0], "fsj_hi": [1.1]}, risk=0.9)
        self.refused(ema.prognosis, {"cycle": [1.0], "fsj_lo": [1.0], "fsj_hi": [1.1]}, {"wear": 3})

    def test_what_has_no_number_is_a_type_error(self):
        for wrong in ("a", None, [1]):
            with self.assertRaises(TypeError):
                ema.run(fsj=wrong)
        with self.assertRaises(OverflowError):
            ema.run(seed=-1)

    def test_files(self):
        with self.assertRaises(FileNotFoundError):
            ema.diagnose(self.file("nothing.csv"))
        with self.assertRaises(FileNotFoundError):
            ema.Actuator.from_toml(self.file("nothing.toml"))
        with self.assertRaises(FileNotFoundError):
            ema.Maps.load(self.file("nothing"))
        path = self.file("run.csv")
        with open(path, "w") as f:
            f.write("t,com,theta_m,omega_m,i_eq\n0.0001,0,0,0,0\n0.0002,0,x,0,0\n")
        e = self.refused(ema.diagnose, path)
        self.assertEqual((e.file, e.place, e.found), (path, "line 3, column `theta_m`", "`x`"))
        torn = self.file("torn.parquet")
        with open(torn, "wb") as f:
            f.write(b"PAR1" + bytes(100))
        self.assertEqual(self.refused(ema.diagnose, torn).file, torn)
        wrong = self.file("wrong.toml")
        with open(wrong, "w") as f:
            f.write(ema.Actuator().to_toml().replace("[motor]", "[motor]\ncolour = 3"))
        self.assertEqual(self.refused(ema.Actuator.from_toml, wrong).file, wrong)

    def test_tables(self):
        e = self.refused(ema.diagnose, {"t": [0.1, 0.2], "com": [0.0, 0.0]})
        self.assertEqual((e.file, e.place), ("table", "columns"))
        columns = {n: [0.0] * 3 for n in ("com", "theta_m", "omega_m", "i_eq")}
        e = self.refused(ema.diagnose, {"t": [0.1, 0.3, 0.2], **columns})
        self.assertEqual((e.file, e.place), ("table", "row 3, column `t`"))
        self.refused(ema.diagnose, object())
        e = self.refused(ema.prognosis, {"fsj_lo": [1.0], "fsj_hi": [1.1]})
        self.assertEqual(e.file, "table")
        self.assertNotIn("/tmp", str(e))

    def test_a_refusal_goes_to_other_processes(self):
        e = self.refused(ema.run, zeta=1.5)
        again = pickle.loads(pickle.dumps(e))
        self.assertEqual((str(again), again.place, again.allowed), (str(e), e.place, e.allowed))


if __name__ == "__main__":
    unittest.main()
