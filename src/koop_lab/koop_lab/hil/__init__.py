"""Hardware in the loop: scenarios with faults on the real nodes, and their verdicts."""
