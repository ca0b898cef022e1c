"""What the benchmarks run, also in other languages."""
