"""From results to the report: tables, figures, one page."""
