"""The command line ``pcnde``: one function for each command.

It parses options, calls the public API and prints results; nothing is computed here.
"""
