"""What rendered pictures are made of and measured by: scenes, images, and differences between them."""
