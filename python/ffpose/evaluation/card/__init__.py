"""Model cards: weights under the conditions of their training and others."""
