"""Pages that need nothing else: tables, and figures that uPlot draws; one style for all."""
