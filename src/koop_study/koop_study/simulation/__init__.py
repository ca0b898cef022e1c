"""What decides results: cases, their disturbances, the loop, static maps, lifted costs."""
