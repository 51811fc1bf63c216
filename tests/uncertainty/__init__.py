"""Tests of what images tell about parameters."""
