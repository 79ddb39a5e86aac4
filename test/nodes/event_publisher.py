"""A node that publishes std_msgs/Empty while it has a recorder open and close a bag.

Standard output gets one line of JSON: what the recorder answered when it was stopped.
"""

import json
import sys

import rclpy
from rclpy.node import Node
from rotcal_msgs.srv import StartRecording, StopRecording
from std_msgs.msg import Empty

PUBLISHED = 40

rclpy.init()
node = Node("event_publisher", namespace="/cell")
publisher = node.create_publisher(Empty, "event", 100)


def answer(kind, name, request):
    client = node.create_client(kind, name)
    client.wait_for_service()
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future)
    return future.result()


started = answer(StartRecording, "start_recording", StartRecording.Request(plan_id="empty"))
while publisher.get_subscription_count() == 0:
    rclpy.spin_once(node, timeout_sec=0.05)
for _ in range(PUBLISHED):
    publisher.publish(Empty())
    rclpy.spin_once(node, timeout_sec=0.01)
publisher.wait_for_all_acked()
stopped = answer(StopRecording, "stop_recording", StopRecording.Request())
said = {"started": started.success, "stopped": stopped.success, "said": stopped.message}
sys.stdout.write(json.dumps(said) + "\n")
sys.stdout.flush()
rclpy.shutdown()
