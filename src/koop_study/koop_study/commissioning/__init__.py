"""Rigs of the family commissioned offline: excited, tuned and verified by the code of ``koop``."""
