"""What an excitation visits and shows."""
