"""Run the tests of the encoder and the taxels by the kernel's own calls.

Without hardware: a library that is loaded before all others leads ``/dev/i2c-*`` and
``/dev/bus/usb`` to simulated devices, and smbus2 and our USB calls run as they are. It needs Linux,
a C compiler and smbus2; the project's own tests need none of them.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
TESTS = (ROOT / "tests" / "exumi_recorders" / "drivers" / "test_as5600.py", HERE / "usb_tests.py")


def main() -> int:
    """Compile the library, run the tests with it, and return their exit status."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        print("no C compiler is here")
        return 2
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "shim.so"
        flags = ("-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-o", str(library))
        subprocess.run([compiler, *flags, str(HERE / "shim.c"), "-ldl"], check=True)
        environment = {
            **os.environ,
            "LD_PRELOAD": str(library),
            "EXUMI_I2C_SHIM": str(Path(folder) / "i2c"),
            "EXUMI_USB_SHIM": str(Path(folder) / "usb"),
            "PYTHONPATH": os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")]),
        }
        options = ("-q", "-p", "no:cacheprovider", "--rootdir", str(ROOT))
        command = [sys.executable, "-m", "pytest", *options, *map(str, TESTS), *sys.argv[1:]]
        return subprocess.run(command, env=environment, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
