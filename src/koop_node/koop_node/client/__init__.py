"""Asking nodes from outside."""
