"""The search for the constants, and what they predict."""
