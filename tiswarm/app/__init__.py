"""What a person sees: runs and logs that show themselves, drawings, mistakes, the console."""
