"""What a stream of messages says: arrival, age, losses, findings."""
