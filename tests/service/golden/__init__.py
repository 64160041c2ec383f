"""Exchanges with real servers, recorded once, that every later version must answer byte for byte."""
