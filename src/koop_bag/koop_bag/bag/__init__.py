"""A bag: folder, metadata, topics; read, written, recovered, compared, exported."""
