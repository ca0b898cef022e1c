"""Who commands theta, and within which limits."""
