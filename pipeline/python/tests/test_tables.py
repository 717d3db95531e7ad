"""Tables in and out, with whichever libraries are there."""

import pickle
import struct
import unittest

import ema
from common import Folder, has, needs

CHANNELS = ["com", "theta_u", "theta_m", "omega_m", "i_eq", "i_a", "i_b", "i_c"]


class Tables(Folder):
    @classmethod
    def setUpClass(cls):
        cls.run_ = ema.run(fsj=2.5, zeta=0.2, sensors="reference")
        # maps of the coarse grid are made in a moment
        cls.maps = ema.maps(grid="coarse")
        cls.found = ema.diagnose(cls.run_, maps=cls.maps)

    def diagnosed(self, table):
        """A table that says nothing of itself is diagnosed alike."""
        self.assertEqual(ema.diagnose(table, maps=self.maps), self.found)

    def test_a_table_says_what_it_holds(self):
        t = self.run_
        self.assertEqual(len(t), 30_000)
        self.assertEqual(t.columns[:5], ["run", "fsj", "zeta", "rest_angle_rad", "t_ns"])
        self.assertEqual(t.keys(), t.columns)
        self.assertEqual(t.units["omega_m"], "rad/s")
        self.assertEqual(t.metadata["ema.rate_hz"], "10000")
        self.assertIn("30000 rows", repr(t))
        with self.assertRaises(KeyError):
            t.column("speed")
        self.assertEqual(self.found["outcome"], "located")

    @unittest.skipIf(has("numpy"), "numpy is there")
    def test_without_numpy_a_column_is_a_memoryview(self):
        column = self.run_["theta_m"]
        self.assertIsInstance(column, memoryview)
        self.assertEqual((column.format, column.shape, column.readonly), ("f", (30_000,), True))
        self.assertEqual(struct.unpack("<f", column.tobytes()[-4:])[0], column[-1])
        names = ["t_ns", *CHANNELS]
        self.diagnosed({n: self.run_[n] for n in names})

    @needs("numpy")
    def test_a_column_is_an_array_of_numpy(self):
        import numpy

        t = self.run_
        self.assertEqual([t[c].dtype for c in ("run", "fsj", "t_ns", "i_a")], [numpy.uint64, numpy.float64, numpy.int64, numpy.float32])
        self.assertFalse(t["i_a"].flags.writeable)
        self.assertEqual(t["t_ns"][-1], 3_000_000_000)
        # what is missing is NaN; a step has no sine and no ramp
        f = ema.sweep(fsj=2.0, zeta=[0.0, 0.1], sequence="step")
        self.assertTrue(numpy.isnan(f["p2_a"]).all())
        self.assertFalse(numpy.isnan(f["rise_s"]).any())
        self.assertFalse(numpy.isnan(f["p1_rad_per_s"]).any())

    @needs("numpy")
    def test_arrays_of_numpy_are_diagnosed(self):
        columns = {n: self.run_[n].copy() for n in ["t_ns", *CHANNELS]}
        self.diagnosed(columns)
        columns["t"] = columns.pop("t_ns") * 1e-9
        self.diagnosed({n: c.astype(float) for n, c in columns.items()})
        # every second of an array of twice the length
        self.diagnosed({n: c.repeat(2)[::2] for n, c in columns.items()})

    @needs("polars")
    def test_polars(self):
        import polars

        d = polars.DataFrame(self.run_)
        self.assertEqual(d.shape, (30_000, 13))
        self.assertEqual(d["i_a"].dtype, polars.Float32)
        self.diagnosed(d)
        self.diagnosed(d.select(["t_ns", *CHANNELS]).with_columns(polars.col("i_a").cast(polars.Float64)))
        self.diagnosed({n: d[n] for n in d.columns})
        history = polars.DataFrame({"actuator": ["a"] * 30, "cycle": range(30), "fsj_lo": [1 + 0.05 * k for k in range(30)], "fsj_hi": [1.1 + 0.05 * k for k in range(30)], "fsj_estimate": [1.05 + 0.05 * k for k in range(30)]})
        self.assertEqual(ema.prognosis(history, {"fsj": 4})[0]["actuator"], "a")

    @needs("pandas")
    def test_pandas(self):
        import pandas

        d = pandas.DataFrame(self.run_.to_dict())
        self.assertEqual(d.shape, (30_000, 13))
        self.diagnosed(d)
        times = pandas.date_range("2025-01-01", periods=30, freq="D")
        level = [1 + 0.05 * k for k in range(30)]
        history = pandas.DataFrame({"actuator": "a", "time": times, "fsj_lo": level, "fsj_hi": [x + 0.1 for x in level]})
        self.assertEqual(ema.prognosis(history, {"fsj": 4})[0]["clock"], "day")
        if has("pyarrow") and hasattr(pandas.DataFrame, "from_arrow"):
            self.assertTrue(pandas.DataFrame.from_arrow(self.run_).equals(d))

    @needs("pyarrow")
    def test_pyarrow(self):
        import pyarrow

        t = pyarrow.table(self.run_)
        self.assertEqual((t.num_rows, t.num_columns), (30_000, 13))
        self.assertEqual(t.schema.metadata[b"ema.sequence"], b"preflight")
        self.assertEqual(t.schema.field("i_a").metadata, {b"unit": b"A"})
        self.diagnosed(t)
        self.diagnosed(t.to_batches()[0])
        # in pieces, and a slice of something longer
        self.diagnosed(pyarrow.Table.from_batches(t.to_batches(max_chunksize=777)))
        self.diagnosed(pyarrow.concat_tables([t, t]).slice(30_000))
        self.assertEqual(pyarrow.schema(self.run_), t.schema)

    def test_lists_make_a_table(self):
        t = ema.Table({"a": [1, 2.5, None], "b": ["x", None, "z"]})
        self.assertEqual(list(t["a"])[:2], [1.0, 2.5])
        self.assertEqual(t["b"], ["x", None, "z"])
        for wrong in ({}, 7, {"a": [1], "b": [1, 2]}, {1: [1]}, {"a": 3}):
            with self.assertRaises(ema.InputError):
                ema.Table(wrong)

    def test_a_table_is_saved_and_found_again(self):
        path = self.file("run.parquet")
        self.run_.save(path)
        self.assertEqual(ema.diagnose(path, maps=self.maps), self.found)

    def test_actuators(self):
        a = ema.Actuator()
        self.assertEqual(a.name, "reference")
        self.assertEqual(a.gear_ratio, 500.0)
        self.assertEqual(set(a.parameters), set(a.units))
        b = a.with_(gear_ratio=400, name="other")
        self.assertEqual((b.gear_ratio, b.name, a.gear_ratio), (400.0, "other", 500.0))
        self.assertNotEqual(a, b)
        self.assertEqual(b.with_(gear_ratio=500, name="reference"), a)
        self.assertEqual(ema.Actuator.from_toml(b.to_toml()), b)
        path = self.file("b.toml")
        with open(path, "w") as f:
            f.write(b.to_toml())
        self.assertEqual(ema.Actuator.from_toml(path), b)
        self.assertEqual(pickle.loads(pickle.dumps(b)), b)
        self.assertEqual(len({a, b, ema.Actuator()}), 2)
        with self.assertRaises(AttributeError):
            a.gear
        with self.assertRaises(AttributeError):
            a.gear_ratio = 3


if __name__ == "__main__":
    unittest.main()
