"""The kinds of experiments and the files that declare them."""
