# SPDX-License-Identifier: Apache-2.0
"""Models of `transformers`, random and a thousandth of the smallest real ones, saved to disk.

Whoever imports this needs the extra `models`.
"""

import torch
import transformers

# Every word that a tiny tokenizer knows.
WORDS = ["<pad>", "<unk>", "<image>", "a", "photo", "of", "many", "one", "among", "box", "USER",
         *map(str, range(30))]


def save_dino(folder, hidden=24):
    """A DINOv2 of one layer."""
    torch.manual_seed(0)
    transformers.Dinov2Model(transformers.Dinov2Config(
        hidden_size=hidden, num_hidden_layers=1, num_attention_heads=2, patch_size=14,
        image_size=448, mlp_ratio=2)).save_pretrained(folder)
    return folder


def save_vit(folder):
    """A ViT of one layer, as it was trained to classify: without a pooling layer."""
    torch.manual_seed(0)
    transformers.ViTForImageClassification(transformers.ViTConfig(
        hidden_size=24, num_hidden_layers=1, num_attention_heads=2, patch_size=16, image_size=64,
        intermediate_size=16)).save_pretrained(folder)
    return folder


def save_sam2(folder):
    """A SAM 2 video model of 64 pixels, whose files hold the one for pictures."""
    torch.manual_seed(0)
    backbone = transformers.Sam2HieraDetConfig(
        image_size=[64, 64], hidden_size=8, num_attention_heads=1, blocks_per_stage=[1, 1, 2, 1],
        embed_dim_per_stage=[8, 16, 32, 64], num_attention_heads_per_stage=[1, 1, 1, 1],
        window_positional_embedding_background_size=[4, 4], global_attention_blocks=[3],
        window_size_per_stage=[8, 4, 4, 2])
    vision = transformers.Sam2VisionConfig(
        backbone_config=backbone, backbone_channel_list=[64, 32, 16, 8], fpn_hidden_size=128,
        backbone_feature_sizes=[[16, 16], [8, 8], [4, 4]])
    config = transformers.Sam2VideoConfig(
        vision_config=vision, image_size=64,
        prompt_encoder_config={"hidden_size": 128, "image_size": 64, "patch_size": 16},
        mask_decoder_config={"hidden_size": 128, "mlp_dim": 32, "num_attention_heads": 2,
                             "iou_head_hidden_dim": 32},
        memory_attention_hidden_size=128, memory_attention_num_layers=1,
        memory_attention_num_attention_heads=1, memory_attention_feed_forward_hidden_size=32,
        memory_attention_rope_feat_sizes=[4, 4], memory_encoder_hidden_size=128,
        memory_encoder_output_channels=64, mask_downsampler_embed_dim=128,
        memory_fuser_embed_dim=128, memory_fuser_intermediate_dim=32, memory_fuser_num_layers=1)
    transformers.Sam2VideoModel(config).save_pretrained(folder)
    return folder


def word_tokenizer():
    """One token a word."""
    from tokenizers import Tokenizer, models, pre_tokenizers

    tokenizer = Tokenizer(models.WordLevel({w: i for i, w in enumerate(WORDS)}, "<unk>"))
    tokenizer.pre_tokenizer = pre_tokenizers.WhitespaceSplit()
    return transformers.PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, pad_token="<pad>", unk_token="<unk>", eos_token="<pad>",
        bos_token="<pad>", extra_special_tokens={"image_token": "<image>"})


def save_clip(folder, image_size=32):
    """A CLIP model with a tokenizer."""
    torch.manual_seed(0)
    sides = {"hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 1,
             "num_attention_heads": 2}
    config = transformers.CLIPConfig(
        text_config={**sides, "vocab_size": len(WORDS), "eos_token_id": 0, "bos_token_id": 0,
                     "pad_token_id": 0},
        vision_config={**sides, "image_size": image_size, "patch_size": 16}, projection_dim=8)
    transformers.CLIPModel(config).save_pretrained(folder)
    word_tokenizer().save_pretrained(folder)
    return folder


def save_llava(folder, image_size=32):
    """An image-text model with its processor and chat template."""
    torch.manual_seed(0)
    sides = {"hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 1,
             "num_attention_heads": 2}
    vision = transformers.CLIPVisionConfig(**sides, image_size=image_size, patch_size=16)
    text = transformers.LlamaConfig(**sides, num_key_value_heads=2, vocab_size=len(WORDS),
                                    pad_token_id=0, bos_token_id=0, eos_token_id=None)
    config = transformers.LlavaConfig(vision_config=vision, text_config=text,
                                      image_token_index=WORDS.index("<image>"),
                                      vision_feature_select_strategy="default")
    transformers.LlavaForConditionalGeneration(config).save_pretrained(folder)
    from transformers.models.clip.image_processing_pil_clip import CLIPImageProcessorPil

    transformers.LlavaProcessor(
        CLIPImageProcessorPil(size={"shortest_edge": image_size},
                              crop_size={"height": image_size, "width": image_size}),
        word_tokenizer(), patch_size=16, vision_feature_select_strategy="default",
        num_additional_image_tokens=1,
        chat_template="{% for m in messages %}USER {% for c in m['content'] %}"
                      "{% if c['type'] == 'image' %}<image> {% else %}{{ c['text'] }} "
                      "{% endif %}{% endfor %}{% endfor %}").save_pretrained(folder)
    return folder
