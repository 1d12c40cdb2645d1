"""The library of measured files: fetched, identified, imported, stored."""
