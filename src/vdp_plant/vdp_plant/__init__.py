"""The paper's forced Van der Pol oscillator with measurement interference: model and node."""
