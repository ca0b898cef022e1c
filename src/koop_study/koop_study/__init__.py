"""The study: declarative experiments on the offline loop, one report. ``koop study`` runs it."""
