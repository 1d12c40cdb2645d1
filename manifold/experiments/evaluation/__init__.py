"""How good models are: methods side by side, judged by materials they have not seen."""
