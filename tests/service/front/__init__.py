"""Tests of the front alone, whose lanes are canned."""
