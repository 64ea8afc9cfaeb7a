"""A rig's own tables as recordings: which column is which channel stands in a YAML map."""
