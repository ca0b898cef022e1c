"""Controllers that the study compares with the paper's relay."""
