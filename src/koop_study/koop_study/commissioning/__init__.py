"""Rigs of the family commissioned offline: excited, tuned and verified by what ``koop`` does."""
