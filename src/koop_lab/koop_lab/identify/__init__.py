"""Identification from recordings: any numeric fields of any bag, in memory that stays the same."""
