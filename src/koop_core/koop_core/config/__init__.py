"""Configuration classes, parameter files and errors."""
