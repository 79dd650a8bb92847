"""Starts an installed executable as `ros2 run` would, waits for a block of samples, ends it with SIGINT.

    starts.py EXECUTABLE [ARGUMENT ...]

Exit code 0 only if a block arrived and the process then ended by itself with exit code 0.
"""

import signal
import subprocess
import sys
import time

import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

FIRST_BLOCK = 600.0  # s; the first start compiles the model, on a busy machine
END = 10.0  # s


def first_block(process: "subprocess.Popen[bytes]") -> PointCloud2 | None:
    """The first message with samples; None if the process ends or the time runs out before it."""
    rclpy.init()
    node = rclpy.create_node("first_block")
    blocks: list[PointCloud2] = []
    node.create_subscription(PointCloud2, "daq/samples", blocks.append, qos_profile_sensor_data)
    deadline = time.monotonic() + FIRST_BLOCK
    while time.monotonic() < deadline and process.poll() is None:
        rclpy.spin_once(node, timeout_sec=0.1)
        if blocks and blocks[0].width * blocks[0].height > 0:
            break
        blocks.clear()
    node.destroy_node()
    rclpy.try_shutdown()
    return blocks[0] if blocks else None


def main(command: list[str]) -> str | None:
    """Nothing if all went well, else the sentence that says what did not."""
    start = time.monotonic()
    # A session of its own: a shell's background job would ignore SIGINT.
    process = subprocess.Popen(command, start_new_session=True)
    try:
        block = first_block(process)
        if block is None:
            state = "still runs" if process.poll() is None else f"ended with exit code {process.poll()}"
            return f"{command[0]} published no samples in {time.monotonic() - start:.0f} s and {state}"
        sys.stdout.write(f"{block.width * block.height} samples after {time.monotonic() - start:.1f} s\n")
        process.send_signal(signal.SIGINT)
        code = process.wait(END)
    except subprocess.TimeoutExpired:
        return f"{command[0]} still runs {END:.0f} s after SIGINT"
    finally:
        process.kill()
    return f"{command[0]} ended with exit code {code} after SIGINT" if code else None


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
