"""The structs and numbers are the kernel's own."""

import ctypes
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from exumi_recorders.drivers import v4l2

HEADER = Path("/usr/include/linux/videodev2.h")
# Of fields behind which padding or a pointer could differ.
OFFSETS = {
    "v4l2_capability": ["card", "capabilities", "device_caps"],
    "v4l2_fmtdesc": ["description", "pixelformat"],
    "v4l2_frmsizeenum": ["pixel_format", "type"],
    "v4l2_frmivalenum": ["width", "height", "type"],
    "v4l2_pix_format": ["pixelformat", "bytesperline", "sizeimage"],
    "v4l2_format": ["fmt"],
    "v4l2_streamparm": ["parm"],
    "v4l2_requestbuffers": ["memory", "capabilities"],
    "v4l2_buffer": ["bytesused", "flags", "field", "sequence", "memory", "m", "length"],
    "v4l2_query_ext_ctrl": ["name", "minimum", "default_value", "flags", "elems"],
    "v4l2_ext_control": ["size", "value"],
    "v4l2_ext_controls": ["count", "error_idx", "controls"],
}
CONSTANTS = {
    "V4L2_PIX_FMT_MJPEG": v4l2.FOURCC_MJPG,
    "V4L2_PIX_FMT_YUYV": v4l2.FOURCC_YUYV,
    "V4L2_BUF_FLAG_ERROR": v4l2.BUF_FLAG_ERROR,
    "V4L2_BUF_FLAG_TIMESTAMP_MASK": v4l2.BUF_FLAG_TIMESTAMP_MASK,
    "V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC": v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC,
    "V4L2_BUF_FLAG_TSTAMP_SRC_MASK": v4l2.BUF_FLAG_TSTAMP_SRC_MASK,
    "V4L2_BUF_FLAG_TSTAMP_SRC_SOE": v4l2.BUF_FLAG_TSTAMP_SRC_SOE,
    "V4L2_BUF_TYPE_VIDEO_CAPTURE": v4l2.BUF_TYPE_VIDEO_CAPTURE,
    "V4L2_MEMORY_MMAP": v4l2.MEMORY_MMAP,
    "V4L2_CAP_VIDEO_CAPTURE": v4l2.CAP_VIDEO_CAPTURE,
    "V4L2_CAP_STREAMING": v4l2.CAP_STREAMING,
    "V4L2_CAP_DEVICE_CAPS": v4l2.CAP_DEVICE_CAPS,
    "V4L2_CAP_TIMEPERFRAME": v4l2.CAP_TIMEPERFRAME,
    "V4L2_FRMSIZE_TYPE_DISCRETE": v4l2.FRAME_DISCRETE,
    "V4L2_FRMIVAL_TYPE_DISCRETE": v4l2.FRAME_DISCRETE,
    "V4L2_CTRL_FLAG_DISABLED": v4l2.CTRL_FLAG_DISABLED,
    "V4L2_CTRL_FLAG_READ_ONLY": v4l2.CTRL_FLAG_READ_ONLY,
    "V4L2_CTRL_FLAG_WRITE_ONLY": v4l2.CTRL_FLAG_WRITE_ONLY,
    "V4L2_CTRL_FLAG_NEXT_CTRL": v4l2.CTRL_FLAG_NEXT_CTRL,
    "V4L2_CTRL_TYPE_INTEGER": v4l2.CTRL_NUMBERS[0],
    "V4L2_CTRL_TYPE_BOOLEAN": v4l2.CTRL_NUMBERS[1],
    "V4L2_CTRL_TYPE_MENU": v4l2.CTRL_NUMBERS[2],
    "V4L2_CTRL_TYPE_INTEGER_MENU": v4l2.CTRL_NUMBERS[3],
    "V4L2_CID_EXPOSURE_AUTO": 0x009A_0901,
    "V4L2_CID_EXPOSURE_ABSOLUTE": 0x009A_0902,
    "V4L2_CID_EXPOSURE_AUTO_PRIORITY": 0x009A_0903,
    "V4L2_CID_FOCUS_AUTO": 0x009A_090C,
    "V4L2_CID_ZOOM_ABSOLUTE": 0x009A_090D,
    "V4L2_CID_AUTO_WHITE_BALANCE": 0x0098_090C,
    "V4L2_CID_WHITE_BALANCE_TEMPERATURE": 0x0098_091A,
    "V4L2_CID_GAIN": 0x0098_0913,
    "V4L2_CID_AUTOGAIN": 0x0098_0912,
    "V4L2_CID_GAMMA": 0x0098_0910,
}

pytestmark = pytest.mark.skipif(sys.maxsize < 1 << 32, reason="32-bit machines are out of scope")


def test_structs_have_the_sizes_of_64_bit_linux() -> None:
    sizes = {name: ctypes.sizeof(struct) for name, (struct, _) in v4l2.STRUCTS.items()}
    assert sizes == {name: size for name, (_, size) in v4l2.STRUCTS.items()}
    assert v4l2.Buffer.seconds.offset == 24
    assert v4l2.Buffer.m.offset == 64
    assert v4l2.VIDIOC_DQBUF == 0xC058_5611
    if sys.platform.startswith("linux"):
        v4l2.check_machine()


@pytest.mark.skipif(
    shutil.which("gcc") is None or not HEADER.exists(), reason="needs gcc and the kernel's header"
)
def test_they_are_those_of_the_kernels_header(tmp_path: Path) -> None:
    ours: dict[str, int] = {}
    lines = []
    for name, (struct, _) in v4l2.STRUCTS.items():
        ours[f"sizeof {name}"] = ctypes.sizeof(struct)
        lines.append(f'printf("sizeof {name}=%zu\\n", sizeof(struct {name}));')
        for field in OFFSETS[name]:
            ours[f"{name}.{field}"] = getattr(struct, field).offset
            lines.append(f'printf("{name}.{field}=%zu\\n", offsetof(struct {name}, {field}));')
    ours["v4l2_buffer.timestamp"] = v4l2.Buffer.seconds.offset
    lines.append('printf("v4l2_buffer.timestamp=%zu\\n", offsetof(struct v4l2_buffer, timestamp));')
    for name, number in (*v4l2.IOCTLS.items(), *CONSTANTS.items()):
        ours[name] = number
        lines.append(f'printf("{name}=%lu\\n", (unsigned long)(unsigned int){name});')
    source = tmp_path / "sizes.c"
    includes = "#include <linux/videodev2.h>\n#include <stddef.h>\n#include <stdio.h>\n"
    source.write_text(f"{includes}int main(void) {{\n{chr(10).join(lines)}\nreturn 0;\n}}\n")
    program = tmp_path / "sizes"
    subprocess.run(["gcc", str(source), "-o", str(program)], check=True)
    text = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout
    theirs = {
        key: int(value) for key, _, value in (line.partition("=") for line in text.split("\n")[:-1])
    }
    assert ours == theirs


def test_letters_of_formats() -> None:
    assert v4l2.fourcc_text(v4l2.FOURCC_MJPG) == "MJPG"
    assert v4l2.fourcc_text(v4l2.fourcc("YUYV")) == "YUYV"
