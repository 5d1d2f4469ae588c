"""Shipped models: one safetensors file each, with its card in the header."""
