"""A simulator's clock: /clock at the pace that lines on standard input say; 0 is a pause."""

import select
import sys
import time

import rclpy
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

PERIOD_S = 0.01
BEGIN_S = 100.0


def main():
    rclpy.init()
    node = rclpy.create_node("simulator")
    publisher = node.create_publisher(Clock, "/clock", 10)
    pace, sim_s, looked_s = float(sys.argv[1]), BEGIN_S, time.monotonic()
    while True:
        if select.select([sys.stdin], [], [], PERIOD_S)[0]:
            line = sys.stdin.readline()
            if not line:
                return
            pace = float(line)
        now_s = time.monotonic()
        sim_s, looked_s = sim_s + pace * (now_s - looked_s), now_s
        if pace:
            whole_ns = int(sim_s * 1e9)
            stamp = Time(sec=whole_ns // 10**9, nanosec=whole_ns % 10**9)
            publisher.publish(Clock(clock=stamp))


if __name__ == "__main__":
    main()
