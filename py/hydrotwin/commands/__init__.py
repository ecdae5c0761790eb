"""The commands, by what they do: show, inspect, fit, compare, export."""
