"""The loop as real node processes over DDS."""
