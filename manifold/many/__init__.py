"""Commands for many inputs, which write a folder of results, a table, and a contact sheet."""
