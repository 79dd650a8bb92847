"""What the eigenvalues do not say: branches of squeal cycles and maps of zones, as pictures, tables and pages."""
