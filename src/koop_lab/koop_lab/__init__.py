"""The koop commands: demo, train, replay, plots, benchmarks."""
