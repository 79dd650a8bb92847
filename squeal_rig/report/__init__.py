"""Tables and figures from bags."""
