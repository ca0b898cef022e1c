"""Serialized messages: definitions, layouts, fields without decoding."""
