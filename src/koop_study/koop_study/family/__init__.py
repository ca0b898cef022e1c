"""A family of random rigs: oscillators whose amplitude depends on theta, with known truths."""
