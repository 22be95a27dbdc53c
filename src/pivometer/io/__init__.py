"""Files: session folders and images in, results out."""
