"""The ``koop`` command line and what its commands share."""
