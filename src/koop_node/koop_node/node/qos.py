"""Quality of service of the topics (docs/explanation/decisions/0007)."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# What is recorded: a writer keeps this many samples for a reader that was not scheduled for a
# while; the oldest are lost after that. In lockstep, at 4 kHz, a depth of 100 lost 2 % of a run to
# a busy machine.
RELIABLE = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)

# Matches any writer: drivers often offer best effort only.
BEST_EFFORT = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT)

# Commands in real time: an older one has nothing to say once there is a newer one.
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)

# The last one counts, also for a listener that comes later.
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
