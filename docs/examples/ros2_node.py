"""A ROS 2 node: a box on /target/init starts, every image on /image is tracked, the box goes to /target/detection.

    python ros2_node.py --ros-args -r /image:=/camera/image_raw

Needs ROS 2 (rclpy, cv_bridge, sensor_msgs, vision_msgs) and mfcmt in the same Python.
"""

from __future__ import annotations

import rclpy
from cv_bridge import CvBridge
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image
from vision_msgs.msg import BoundingBox2D, Detection2D, ObjectHypothesisWithPose

from mfcmt_core import MFCMT, MFCMTError


class TrackerNode(Node):
    """Tracks one target in the newest images; a box that comes while it tracks starts it anew."""

    def __init__(self) -> None:
        super().__init__("mfcmt")
        self._bridge, self._tracker = CvBridge(), MFCMT()
        self._begin: tuple[float, float, float, float] | None = None
        self._runs = False
        self._found = self.create_publisher(Detection2D, "target/detection", 10)
        self.create_subscription(BoundingBox2D, "target/init", self._start, 1)
        self.create_subscription(Image, "image", self._track, qos_profile_sensor_data)

    def _start(self, box: BoundingBox2D) -> None:
        center, w, h = box.center.position, box.size_x, box.size_y
        self._begin = (center.x - w / 2, center.y - h / 2, w, h)

    def _track(self, message: Image) -> None:
        image = self._bridge.imgmsg_to_cv2(message, "bgr8")
        try:
            if self._begin is not None:
                begin, self._begin = self._begin, None
                result, self._runs = self._tracker.init(image, begin), True
            elif self._runs:
                result = self._tracker.update(image)
            else:
                return
        except MFCMTError as refused:  # a box outside the image, or an image of another size
            self.get_logger().warning(str(refused))
            return
        x, y, w, h = result.box
        found = Detection2D(header=message.header, id="0")
        found.bbox.center.position.x, found.bbox.center.position.y = x + w / 2, y + h / 2
        found.bbox.size_x, found.bbox.size_y = w, h
        hypothesis = ObjectHypothesisWithPose()
        hypothesis.hypothesis.class_id, hypothesis.hypothesis.score = result.status, result.confidence
        found.results.append(hypothesis)
        self._found.publish(found)


def main() -> None:
    """Run until the node is stopped."""
    rclpy.init()
    rclpy.spin(TrackerNode())


if __name__ == "__main__":
    main()
