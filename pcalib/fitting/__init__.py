"""From measurements to geometry: identification, what can be identified, and how far to trust it."""
