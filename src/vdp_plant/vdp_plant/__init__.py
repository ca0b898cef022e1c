"""The paper's Van der Pol plant with its interference: pure model and a thin node."""
