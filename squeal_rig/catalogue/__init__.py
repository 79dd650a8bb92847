"""All declared settings by node: checks of any YAML file, the table in the docs."""
