"""Topics that all nodes share: reports, logs and changes of parameters."""

from __future__ import annotations

COMMON_TOPICS = {
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
    "/rosout": "rcl_interfaces/msg/Log",
}


def is_common(topic: str) -> bool:
    """Whether every node publishes a topic by itself, so that it shows nothing of the loop."""
    return topic in COMMON_TOPICS or topic == "/clock" or topic.endswith("/transition_event")
