"""The paper's loop: cases, models, runs, static maps."""
