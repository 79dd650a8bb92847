"""Settings: declared once, found in `config/`, read as YAML."""
