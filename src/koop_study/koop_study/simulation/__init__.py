"""The paper's loop under disturbances: cases, models, runs, static maps."""
