"""Long work: without the interpreter's lock, stopped by Ctrl-C, telling how far it is, in threads and processes."""

import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
import unittest

import ema
from common import Folder


def child(fsj):
    return ema.sweep(fsj=[1.0, fsj], zeta=[0.0, 0.1], sequence="step")["rise_s"].tolist()


class Work(Folder):
    def stopped(self, call):
        """Seconds from SIGINT to the end of a process that makes `call`."""
        text = f"""
            import sys, time, ema
            print("ready", flush=True)
            try:
                {call}
            except KeyboardInterrupt:
                # and goes on
                ema.run(sequence="step")
                print("stopped", flush=True)
                sys.exit(7)
            print("too early", flush=True)
        """
        environment = {**os.environ, "EMA_CACHE_DIR": self.file("cache")}
        p = subprocess.Popen([sys.executable, "-c", textwrap.dedent(text)], stdout=subprocess.PIPE, text=True, env=environment)
        self.addCleanup(p.stdout.close)
        self.assertEqual(p.stdout.readline(), "ready\n")
        time.sleep(0.7)
        start = time.monotonic()
        p.send_signal(signal.SIGINT)
        self.assertEqual(p.stdout.readline(), "stopped\n")
        took = time.monotonic() - start
        self.assertEqual(p.wait(10), 7)
        return took

    def test_ctrl_c_stops_a_sweep(self):
        lines = "fsj=[1 + 0.01 * k for k in range(400)], zeta=[0.001 * k for k in range(400)]"
        self.assertLess(self.stopped(f"ema.sweep({lines})"), 2.0)

    def test_ctrl_c_stops_maps(self):
        lines = "fsj=[1 + 0.1 * k for k in range(40)], zeta=[0.01 * k for k in range(40)]"
        self.assertLess(self.stopped(f"ema.maps({lines})"), 2.0)

    def test_ctrl_c_stops_a_run(self):
        path = self.file("long.toml")
        with open(path, "w") as f:
            f.write('name = "long"\n[[segment]]\ncommand = "hold"\nvalue_rad = 0.0\nduration_s = 3600.0\n')
        self.assertLess(self.stopped(f"ema.run(sequence={path!r}, rate_hz=1000.0)"), 2.0)

    def test_other_threads_go_on(self):
        count, done = 0, threading.Event()

        def counting():
            nonlocal count
            while not done.is_set():
                count += 1
                time.sleep(0.001)

        thread = threading.Thread(target=counting)
        thread.start()
        start = time.monotonic()
        ema.sweep(fsj=[1 + 0.05 * k for k in range(20)], zeta=[0.0, 0.1, 0.2, 0.3])
        took = time.monotonic() - start
        seen = count
        done.set()
        thread.join()
        # a thread that were held up would have counted next to nothing
        self.assertGreater(seen, 50 * took)

    def test_calls_in_several_threads(self):
        expected = ema.run(fsj=2.0, zeta=0.1)["theta_m"].tolist()
        found = [None] * 4

        def one(k):
            found[k] = ema.run(fsj=2.0, zeta=0.1)["theta_m"].tolist()

        threads = [threading.Thread(target=one, args=(k,)) for k in range(4)]
        for t in threads:
            t.start()
        for t in threads:
            t.join()
        self.assertEqual(found, [expected] * 4)

    def test_processes_of_their_own(self):
        here = child(2.0)
        for method in ("fork", "spawn"):
            context = multiprocessing.get_context(method)
            with context.Pool(1) as pool:
                self.assertEqual(pool.apply_async(child, (2.0,)).get(60), here, method)

    def test_progress(self):
        seen = []
        ema.sweep(fsj=[1.0, 2.0, 3.0], zeta=[0.0, 0.1], progress=lambda done, total: seen.append((done, total)))
        self.assertEqual(seen[-1], (6, 6))
        self.assertEqual(seen, sorted(seen))
        environment = {**os.environ, "EMA_CACHE_DIR": self.file("cache")}
        text = "import ema; ema.maps(grid='coarse', sensors=None, progress=True)"
        said = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, env=environment, check=True)
        self.assertIn(" of 512 runs", said.stderr)
        quiet = subprocess.run([sys.executable, "-c", text.replace("True", "None")], capture_output=True, text=True, env={**environment, "EMA_CACHE_DIR": self.file("other")}, check=True)
        self.assertEqual((quiet.stdout, quiet.stderr), ("", ""))

    def test_what_a_callback_raises_ends_the_work(self):
        def no(done, total):
            raise LookupError("enough")

        with self.assertRaisesRegex(LookupError, "enough"):
            ema.sweep(fsj=[1 + 0.01 * k for k in range(200)], zeta=[0.0, 0.1], progress=no)
        # and the next works
        self.assertEqual(len(ema.sweep(fsj=2.0, zeta=0.1, sequence="step")), 1)


if __name__ == "__main__":
    unittest.main()
