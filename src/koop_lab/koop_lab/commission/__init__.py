"""Commissioning: from a rig that nobody knows to a recording that a controller is made from."""
