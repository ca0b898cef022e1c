"""One MCAP file: written through to the disk, read whole or torn."""
