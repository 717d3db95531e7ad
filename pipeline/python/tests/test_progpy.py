"""Prognoses as samples."""

import math
import unittest

import ema
from common import needs
from ema.progpy import time_of_event

HISTORY = {
    "actuator": ["a"] * 40,
    "cycle": [float(k) for k in range(40)],
    **{f"fsj_{end}": [1 + 0.05 * k + x for k in range(40)] for end, x in (("lo", -0.05), ("hi", 0.05), ("estimate", 0.0))},
    **{f"zeta_{end}": [0.01 * k + x for k in range(40)] for end, x in (("lo", -0.01), ("hi", 0.01), ("estimate", 0.0))},
}


class Samples(unittest.TestCase):
    def setUp(self):
        self.told = ema.prognosis(HISTORY, {"fsj": 4, "zeta": 0.6}, samples=True)

    def test_samples_are_those_of_the_outlook(self):
        for t in self.told:
            times = t["samples"]
            self.assertEqual(times, sorted(times))
            if t["rul"]["median"] is not None:
                middle = times[len(times) // 2]
                self.assertAlmostEqual(middle, t["rul"]["median"], delta=0.05 * middle)
        plain = ema.prognosis(HISTORY, {"fsj": 4, "zeta": 0.6})
        for t in self.told:
            t.pop("samples")
        self.assertEqual(self.told, plain)

    def test_times_of_events(self):
        samples = list(time_of_event(self.told))
        self.assertGreater(len(samples), 100)
        self.assertEqual(set(samples[0]), {"fsj", "zeta"})
        at, left = self.told[0]["at"], [s["fsj"] for s in time_of_event(self.told, left=True)]
        self.assertEqual([None if x is None else x + at for x in left], [s["fsj"] for s in samples])
        self.assertFalse(any(x is not None and math.isinf(x) for s in samples for x in s.values()))
        alone = list(time_of_event(self.told[0]))
        self.assertEqual(set(alone[0]), {self.told[0]["fault"]})

    @needs("progpy")
    def test_progpy_takes_them(self):
        from progpy.uncertain_data import UnweightedSamples

        found = time_of_event(self.told)
        self.assertIsInstance(found, UnweightedSamples)
        self.assertEqual(set(found.keys()), {"fsj", "zeta"})
        self.assertTrue(found.mean["fsj"] > self.told[0]["at"])


if __name__ == "__main__":
    unittest.main()
