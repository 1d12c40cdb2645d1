"""Commands on many inputs: a folder of results that resumes, a table and a sheet of balls."""
