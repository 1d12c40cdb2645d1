"""The library of measured files: download, identification, import and storage."""
