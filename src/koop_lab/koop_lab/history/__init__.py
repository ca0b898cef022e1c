"""``koop report``: what became of a loop over days and months."""
