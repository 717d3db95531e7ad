"""What the tests share."""

import json
import os
import subprocess
import tempfile
import unittest

PROGRAM = os.environ.get("EMA_PROGRAM")

needs_program = unittest.skipUnless(PROGRAM, "EMA_PROGRAM does not name the program")


def has(package):
    """Whether a package is there."""
    try:
        __import__(package)
        return True
    except ImportError:
        return False


def needs(package):
    """Leaves a test out where a package is not there."""
    return unittest.skipUnless(has(package), f"no {package}")


def program(*arguments):
    """What the program says on standard output."""
    done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True)
    # 3: finished with loss, which is a finding
    assert done.returncode in (0, 3), done.stderr
    return done.stdout


def told(*arguments):
    """The same, as JSON."""
    return json.loads(program(*arguments))


class Folder(unittest.TestCase):
    """A test with a folder of its own."""

    def setUp(self):
        self._folder = tempfile.TemporaryDirectory(prefix="ema-test-")
        self.folder = self._folder.name
        self.addCleanup(self._folder.cleanup)

    def file(self, name):
        return os.path.join(self.folder, name)
